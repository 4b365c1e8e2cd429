"""Compositing against closed forms."""

import numpy as np
import pytest
import torch

from scene.field.volume import composite, contract, median_depth, opacity, psnr, ssim


def slab(sigma, length, samples=200):
    """alpha, near, far of one ray through a uniform slab that begins at distance 1."""
    edges = torch.linspace(1, 1 + length, samples + 1, dtype=torch.float64)
    near, far = edges[None, :-1], edges[None, 1:]
    return opacity(torch.full_like(near, sigma), far - near), near, far


@pytest.mark.parametrize("sigma, length", [(0.1, 1.0), (2.0, 0.5), (30.0, 1.0)])
def test_a_uniform_slab_has_opacity_one_minus_exp_of_its_depth(sigma, length):
    weights, left = composite(slab(sigma, length)[0])
    assert weights.sum().item() == pytest.approx(1 - np.exp(-sigma * length), abs=1e-9)
    assert (weights.sum() + left).item() == pytest.approx(1, abs=1e-12)


def test_an_opaque_wall_takes_all_the_weight_and_hides_what_is_behind():
    weights, left = composite(torch.tensor([[0.0, 1.0, 0.7]]))
    assert weights.tolist() == [[0.0, 1.0, 0.0]] and left.item() == 0


def test_the_median_depth_of_fog_is_where_half_the_light_is_left():
    sigma = 3.0
    assert median_depth(*slab(sigma, 2.0)).item() == pytest.approx(1 + np.log(2) / sigma, abs=1e-6)


def test_a_ray_that_keeps_more_than_half_its_light_has_no_depth():
    assert torch.isnan(median_depth(*slab(0.1, 1.0))).all()


def test_contraction_keeps_the_box_and_brings_everything_else_within_two():
    x = torch.tensor([[0.3, -0.9, 0.1], [1e6, 5.0, -2.0], [0.0, 2.0, 0.0]], dtype=torch.float64)
    c = contract(x)
    assert torch.equal(c[0], x[0]) and c.abs().max() < 2 and c[2, 1].item() == pytest.approx(1.5)


def test_psnr_of_pictures_that_differ_by_a_tenth_is_twenty():
    a = np.zeros((4, 4, 3))
    assert psnr(a, a + 0.1) == pytest.approx(20)
    with pytest.raises(ValueError, match="one shape"):
        psnr(a, a[:2])


def test_structural_similarity_is_one_of_equal_pictures_and_knows_its_closed_forms():
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 256, (40, 50, 3), dtype=np.uint8)
    assert ssim(picture, picture) == pytest.approx(1)
    black, grey = np.zeros((20, 20, 3), np.uint8), np.full((20, 20, 3), 100, np.uint8)
    c1 = (0.01 * 255) ** 2
    assert ssim(black, grey) == pytest.approx(c1 / (100**2 + c1))
    noisy = [ssim(picture, np.clip(picture + rng.normal(0, s, picture.shape), 0, 255).astype(np.uint8)) for s in (5, 50)]
    assert 1 > noisy[0] > noisy[1] > 0 and ssim(picture, 255 - picture) < 0
    with pytest.raises(ValueError, match="one shape"):
        ssim(picture, picture[:-1])
