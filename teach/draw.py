"""The motion is drawn on views of the scene. One stage of the whole job, on the files of the one before.

    python -m teach.draw                           the sketching page: open the address that it prints
    python -m teach.draw user=scripted seed=1      the scripted person
"""

import sys

from conf.pipeline import main

if __name__ == "__main__":
    chosen = [word for word in sys.argv[1:] if word.startswith("user=")]
    main("stages=[sketch]", *([] if chosen else ["user=page"]))
