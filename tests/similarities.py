"""Models in frames of their own, for the tests of what brings them to the robot's base."""

import numpy as np

from scene.frame import Similarity


def random_similarity(seed):
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    return Similarity(float(rng.uniform(0.1, 5)), rotation, rng.normal(size=3))


def unscaled(similarity, to_move):
    """The cameras in a model's frame that ``similarity`` brings to the robot's base."""
    return [camera.moved(np.linalg.inv(similarity.matrix)) for camera in to_move]
