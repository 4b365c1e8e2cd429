"""The sketching page: a motion is drawn in a browser. Start reading at server.py, and at static/page.js for the browser's side."""
