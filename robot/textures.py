"""Procedural surfaces that look like a workshop: planks, cardboard, printed labels, concrete, painted metal,
speckled enamel, squared paper.

Each painter takes (rng, height, width, scale, colour) with height and width in pixels and ``scale`` in pixels per metre, and
returns an RGB picture (height, width, 3) uint8. Details have the sizes they have in life, and there are corners at many
scales: a camera finds its place on every surface. The same seed gives the same picture.
"""

import cv2
import numpy as np

WORDS = ("FRAGILE", "THIS SIDE UP", "PARTS 40x", "M6 x 30", "KEEP DRY", "LOT 7731", "MADE WITH CARE", "TOOLS", "24 PCS", "NO. 0815")
FONTS = (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_COMPLEX, cv2.FONT_HERSHEY_TRIPLEX)


def paint(kind: str, rng: np.random.Generator, height: int, width: int, scale: float, colour) -> np.ndarray:
    """A picture of the named kind; ``colour`` (3,) in [0, 255] is its main colour."""
    if kind not in PAINTERS:
        raise ValueError(f"unknown texture {kind!r}; there are {', '.join(PAINTERS)}")
    picture = PAINTERS[kind](rng, max(height, 4), max(width, 4), float(scale), np.asarray(colour, dtype=np.float32))
    return canvas(picture)


def canvas(picture) -> np.ndarray:
    """A picture of numbers as bytes, which OpenCV can draw on."""
    return np.ascontiguousarray(np.clip(picture, 0, 255).astype(np.uint8))


def wood(rng, height, width, scale, colour):
    """Planks along the width, each with its own tint, grain, knots, and dark joints."""
    v, u = np.mgrid[:height, :width].astype(np.float32) / scale  # metres
    plank = np.floor(v / 0.11).astype(int)
    tint = rng.uniform(0.78, 1.12, plank.max() + 1)[plank]
    shift = rng.uniform(0, 9, plank.max() + 1)[plank]
    wobble = noise(rng, height, width, scale, (0.12, 0.05, 0.02), stretch=9)
    rings = np.sin(v * 420 + shift * 40 + 5 * wobble)
    fibres = noise(rng, height, width, scale, (0.012, 0.005), stretch=14)
    shade = tint * (1 + 0.07 * rings + 0.06 * fibres + 0.06 * noise(rng, height, width, scale, (0.4, 0.1)))
    for _ in range(int(12 * height * width / scale**2) + 2):
        x, y, r = rng.uniform(0, width / scale), rng.uniform(0, height / scale), rng.uniform(0.006, 0.016)
        distance = np.hypot((u - x) / 1.7, v - y) / r
        shade *= 1 - 0.55 * np.exp(-(distance**2)) - 0.12 * np.exp(-((distance - 1.8) ** 2) * 6)
    joint = np.abs((v / 0.11) % 1 - 0.5) > 0.485
    shade = np.where(joint, 0.35, shade)
    picture = canvas(shade[..., None] * colour)
    dots(rng, picture, scale, per_square_metre=380, radius=(0.001, 0.0035))  # worm holes, nail heads, stains
    return scratches(rng, picture, scale, per_square_metre=90)


def cardboard(rng, height, width, scale, colour):
    """Corrugated board with tape, prints, arrows and a barcode."""
    v, _ = np.mgrid[:height, :width].astype(np.float32) / scale
    shade = 1 + 0.03 * np.sin(v * 2 * np.pi / 0.006) + 0.09 * noise(rng, height, width, scale, (0.15, 0.04, 0.01))
    picture = canvas(shade[..., None] * colour)
    middle = int(height * rng.uniform(0.4, 0.6))
    band = int(0.02 * scale)
    if height > 4 * band:
        picture[middle - band : middle + band] = picture[middle - band : middle + band] * 0.4 + np.float32([190, 165, 120]) * 0.6
        cv2.line(picture, (0, middle), (width, middle), (60, 45, 30), 1, cv2.LINE_AA)
    ink = (float(rng.uniform(20, 60)), float(rng.uniform(20, 60)), float(rng.uniform(20, 110)))
    prints(rng, picture, scale, ink, per_square_metre=50)
    arrow(rng, picture, scale, ink)
    barcode(rng, picture, scale)
    return scratches(rng, picture, scale, per_square_metre=60)


def label(rng, height, width, scale, colour):
    """A printed label all around: bands, a badge, rows of text, a barcode."""
    picture = canvas(np.ones((height, width, 1)) * colour)
    picture[: int(0.14 * height)] = picture[int(0.88 * height) :] = colour * 0.35
    accent = tuple(float(c) for c in rng.permutation(255 - colour))
    for centre in np.arange(0.12, 1.0, 0.25):
        at = (int(centre * width), int(0.42 * height))
        cv2.circle(picture, at, int(0.2 * height), accent, -1, cv2.LINE_AA)
        cv2.circle(picture, at, int(0.13 * height), (250, 245, 230), -1, cv2.LINE_AA)
        word = str(rng.choice(["OATS", "BEANS", "TEA", "SALT", "COCOA", "RICE"]))
        write(picture, word, (at[0] - int(0.11 * height), at[1] + int(0.04 * height)), 0.0016 * height, (30, 20, 20), 2)
        write(picture, f"No.{rng.integers(100, 999)}", (at[0] - int(0.17 * height), int(0.78 * height)), 0.0021 * height, (250, 250, 250), 1)
    for _ in range(40):
        at = (int(rng.uniform(0, width)), int(rng.uniform(0.16, 0.86) * height))
        cv2.circle(picture, at, max(int(0.0025 * scale), 1), tuple(float(c) for c in rng.uniform(30, 250, 3)), -1, cv2.LINE_AA)
    barcode(rng, picture, scale)
    return picture * (1 + 0.04 * noise(rng, height, width, scale, (0.03, 0.006)))[..., None]


def concrete(rng, height, width, scale, colour):
    """Tiles of cast concrete with stains, pores and worn paint lines."""
    v, u = np.mgrid[:height, :width].astype(np.float32) / scale
    shade = 1 + 0.08 * noise(rng, height, width, scale, (1.2, 0.4, 0.12)) + 0.04 * noise(rng, height, width, scale, (0.04, 0.015))
    tile = rng.uniform(0.88, 1.08, (64, 64))[(v / 0.6).astype(int) % 64, (u / 0.6).astype(int) % 64]
    joint = (np.abs((v / 0.6) % 1 - 0.5) > 0.49) | (np.abs((u / 0.6) % 1 - 0.5) > 0.49)
    picture = canvas(np.where(joint, 0.5, shade * tile)[..., None] * colour)
    dots(rng, picture, scale, per_square_metre=170, radius=(0.003, 0.012))
    return scratches(rng, picture, scale, per_square_metre=12)


def metal(rng, height, width, scale, colour):
    """Painted sheet metal: brushed, chipped, with stickers, hazard stripes at one end, and bolts."""
    v, u = np.mgrid[:height, :width].astype(np.float32) / scale
    shade = 1 + 0.05 * noise(rng, height, width, scale, (0.2, 0.05)) + 0.06 * noise(rng, height, width, scale, (0.006, 0.003))
    picture = canvas(shade[..., None] * colour)
    stripe = v > (height / scale - 0.035)
    picture[stripe] = np.where((((u + v) / 0.03) % 1 > 0.5)[stripe][:, None], np.float32([235, 190, 30]), np.float32([35, 35, 35]))
    chips = noise(rng, height, width, scale, (0.05, 0.02, 0.008)) > 1.15
    picture[chips] = picture[chips] * 0.25 + np.float32([120, 118, 115]) * 0.75
    prints(rng, picture, scale, (245.0, 245.0, 240.0), per_square_metre=45)
    for x in np.arange(0.015, width / scale, 0.09):
        for y in np.arange(0.015, height / scale, 0.09):
            at = (int(x * scale), int(y * scale))
            cv2.circle(picture, at, max(int(0.005 * scale), 1), (70, 70, 75), -1, cv2.LINE_AA)
            cv2.circle(picture, at, max(int(0.0025 * scale), 1), (175, 175, 180), -1, cv2.LINE_AA)
    return scratches(rng, picture, scale, per_square_metre=90)


def enamel(rng, height, width, scale, colour):
    """Speckled enamel, as camping mugs have it, with a few chips and fine cracks of the glaze."""
    picture = canvas((1 + 0.02 * noise(rng, height, width, scale, (0.06, 0.02)))[..., None] * colour)
    dots(rng, picture, scale, per_square_metre=2600, radius=(0.0008, 0.0024))
    dots(rng, picture, scale, per_square_metre=250, radius=(0.002, 0.004))
    return scratches(rng, picture, scale, per_square_metre=40)


def paper(rng, height, width, scale, colour):
    """Used squared paper: lines every 2 cm, heavier ones every 10 cm, notes, rings of cups, specks."""
    v, u = np.mgrid[:height, :width].astype(np.float32) / scale
    shade = 1 + 0.025 * noise(rng, height, width, scale, (0.3, 0.1, 0.03))
    for step, line, dark in ((0.02, 0.0011, 0.16), (0.1, 0.0022, 0.3)):
        shade = shade - dark * ((u % step < line) | (v % step < line))
    picture = canvas(shade[..., None] * colour)
    for _ in range(int(9 * height * width / scale**2)):
        at = (int(rng.uniform(0, width)), int(rng.uniform(0, height)))
        cv2.circle(picture, at, max(int(rng.uniform(0.02, 0.04) * scale), 1), tuple(map(float, 0.86 * colour)), max(int(0.003 * scale), 1), cv2.LINE_AA)
    ink = (float(rng.uniform(30, 80)), float(rng.uniform(50, 90)), float(rng.uniform(120, 190)))
    prints(rng, picture, scale, ink, per_square_metre=22)
    dots(rng, picture, scale, per_square_metre=1100, radius=(0.0012, 0.004))
    return picture


PAINTERS = {painter.__name__: painter for painter in (wood, cardboard, label, concrete, metal, enamel, paper)}


def noise(rng, height, width, scale, periods, stretch=1.0) -> np.ndarray:
    """(height, width) sum of smooth noises with the given periods [m], ``stretch`` times longer along the width; about unit variance."""
    total = np.zeros((height, width), np.float32)
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    for period in periods:
        steps = np.float32(period * scale), np.float32(period * scale * stretch)
        cells = [int(np.ceil(size / step)) + 4 for size, step in zip((height, width), steps)]
        coarse = rng.standard_normal(cells).astype(np.float32)
        total += cv2.remap(coarse, columns / steps[1] + 1, rows / steps[0] + 1, cv2.INTER_CUBIC)
    return total / np.sqrt(len(periods))


def scratches(rng, picture, scale, per_square_metre):
    height, width = picture.shape[:2]
    mean = picture.mean(axis=(0, 1))
    for _ in range(int(per_square_metre * height * width / scale**2) + 1):
        start = rng.uniform(0, 1, 2) * (width, height)
        end = start + rng.normal(0, 0.03 * scale, 2)
        tone = mean * rng.uniform(0.35, 1.5)
        cv2.line(picture, tuple(map(int, start)), tuple(map(int, end)), tuple(map(float, tone)), 1, cv2.LINE_AA)
    return picture


def dots(rng, picture, scale, per_square_metre, radius):
    """Round spots, darker or lighter than the surface, with radii within ``radius`` [m]."""
    height, width = picture.shape[:2]
    mean = picture.mean(axis=(0, 1))
    for _ in range(int(per_square_metre * height * width / scale**2)):
        at = (int(rng.uniform(0, width)), int(rng.uniform(0, height)))
        tone = mean * rng.choice([rng.uniform(0.4, 0.75), rng.uniform(0.4, 0.75), rng.uniform(1.15, 1.3)])
        cv2.circle(picture, at, max(round(rng.uniform(*radius) * scale), 1), tuple(map(float, tone)), -1, cv2.LINE_AA)


def prints(rng, picture, scale, ink, per_square_metre):
    """Words as they are stencilled on things, some in a box."""
    height, width = picture.shape[:2]
    for _ in range(int(per_square_metre * height * width / scale**2) + 1):
        at = (int(rng.uniform(0, 0.7) * width), int(rng.uniform(0.15, 0.95) * height))
        size = rng.uniform(0.012, 0.03) * scale / 22  # Hershey capitals are 22 px high
        word = str(rng.choice(WORDS))
        write(picture, word, at, size, ink, max(int(2 * size), 1), FONTS[rng.integers(len(FONTS))])
        if rng.random() < 0.4:
            (w, h), _ = cv2.getTextSize(word, FONTS[0], size, 1)
            cv2.rectangle(picture, (at[0] - 4, at[1] - h - 5), (at[0] + w + 6, at[1] + 6), ink, 1, cv2.LINE_AA)


def write(picture, word, at, size, ink, thickness, font=cv2.FONT_HERSHEY_DUPLEX):
    cv2.putText(picture, word, at, font, size, ink, thickness, cv2.LINE_AA)


def arrow(rng, picture, scale, ink):
    height, width = picture.shape[:2]
    for x in (rng.uniform(0.1, 0.3), rng.uniform(0.6, 0.9)):
        foot = (int(x * width), int(0.9 * height))
        cv2.arrowedLine(picture, foot, (foot[0], foot[1] - int(min(0.05 * scale, 0.4 * height))), ink, max(int(0.004 * scale), 1), cv2.LINE_AA, tipLength=0.4)


def barcode(rng, picture, scale):
    height, width = picture.shape[:2]
    w, h = int(min(0.05 * scale, 0.5 * width)), int(min(0.025 * scale, 0.4 * height))
    x, y = int(rng.uniform(0.05, 0.45) * width), int(rng.uniform(0.1, 0.5) * height)
    bars = np.repeat(rng.random(max(w // 3, 1)) < 0.5, 3)
    patch = picture[y : y + h, x : x + len(bars)]
    patch[:] = np.where(bars[: patch.shape[1], None], np.float32(25), np.float32(240))
