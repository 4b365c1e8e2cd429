"""Photographs that show something else than the field learned from all: a thing was moved meanwhile, or a hand was in the way.

    moved(field, views) -> [Odd(view, rectangle, how much)], the oddest first

What a thing's edges or its texture miss by a few pixels says nothing, so that a pixel of a photograph counts only by how far
it lies outside of what the rendering has around it, and the other way round; and a place only if all of it is off.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from scene.camera import View
from scene.exposure import gains, ratios

LONGEST = 200
"""Photographs are compared at so many pixels along their longer side."""
AROUND, BLOCK = 5, 9
"""Pixels across of the neighbourhood whose colours count as the same, and of a place."""
ODD, OTHERS = 0.10, 3.0
"""A place is odd where it is off by so much on average, of white, and so many times what the worst place of the median photograph is:
of sound scenes none is off by more than 0.07, where a tin or a crate was moved by 10 cm several photographs are by 0.1 to 0.2."""
BLURRED = 0.05
"""A field whose median photograph is off by more somewhere has learned too little to tell: sound ones after 20 s have 0.03."""
MARK = (209, 36, 47)


@dataclass(frozen=True, eq=False)
class Odd:
    """A photograph, the place in it that is off most, as x, y, width, height [px], by how much (of white), and what was rendered."""

    view: View
    place: tuple[int, int, int, int]
    off: float
    rendered: np.ndarray

    def picture(self) -> np.ndarray:
        """The photograph with the place marked, and beside it what the field shows (H, 2W, 3) uint8."""
        size = (self.view.camera.width, self.view.camera.height)
        marked = [self.view.image.copy(), cv2.resize(self.rendered, size, interpolation=cv2.INTER_CUBIC)]
        x, y, width, height = self.place
        for image in marked:
            cv2.rectangle(image, (x - width, y - height), (x + 2 * width, y + 2 * height), MARK, max(size[0] // 200, 1))
        return np.hstack(marked)


def moved(field, views, progress=lambda views: views) -> list[Odd]:
    """The views that show what the field, which learned from all of them, does not; the oddest first.
    None of a field that is still blurred."""
    compared = [(view, *_rendered(field, view)) for view in progress(views)]
    exposed = gains(np.array([_exposure(*one) for one in compared]))
    found = [_worst(*one, gain) for one, gain in zip(compared, exposed, strict=True)]
    typical = float(np.median([odd.off for odd in found]))
    least = max(ODD, OTHERS * typical) if typical < BLURRED else np.inf
    return sorted((odd for odd in found if odd.off > least), key=lambda odd: -odd.off)


def _rendered(field, view: View) -> tuple[np.ndarray, np.ndarray]:
    """What the field shows of a view (h, w, 3) uint8, small, and where there is a surface (h, w)."""
    shrink = min(LONGEST / max(view.camera.width, view.camera.height), 1.0)
    image, depth = field.render(view.camera.resized(*(max(round(n * shrink), BLOCK) for n in (view.camera.width, view.camera.height))))
    return image, np.isfinite(depth)


def _exposure(view: View, image, solid) -> np.ndarray:
    """``scene.exposure.ratios`` of a view over the whole rendering."""
    height, width = solid.shape
    x, y = (np.arange(width) + 0.5) * view.camera.width / width, (np.arange(height) + 0.5) * view.camera.height / height
    pixels = np.stack(np.meshgrid(x, y), axis=-1)[solid]
    return ratios(view, pixels, image[solid].astype(np.float32) / 255)


def _worst(view: View, image, solid, gain) -> Odd:
    height, width = solid.shape
    photograph = cv2.resize(view.image, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32) / 255 / gain
    rendered = image.astype(np.float32) / 255
    off = np.maximum(_outside(photograph, rendered), _outside(rendered, photograph)).max(axis=-1)
    told = solid if view.mask is None else solid & cv2.resize(view.mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST).astype(bool)
    mean = cv2.blur(off * told, (BLOCK, BLOCK))
    half = BLOCK // 2
    inside = mean[half : height - half, half : width - half]
    y, x = np.unravel_index(inside.argmax(), inside.shape)
    scale = view.camera.width / width
    place = tuple(int(round(n * scale)) for n in (x, y, BLOCK, BLOCK))
    return Odd(view, place, float(inside.max()), image)


def _outside(image, other) -> np.ndarray:
    """How far the values of an image (h, w, 3) lie beyond all that ``other`` has around there."""
    kernel = np.ones((AROUND, AROUND), np.uint8)
    return np.maximum(image - cv2.dilate(other, kernel), cv2.erode(other, kernel) - image).clip(0)
