from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from teach.bundle import hand_faults
from teach.curve import extent, mean_curve, resample
from teach.hand import PARTS, Hand, faults, measure, own_speed, scaled, tremor

LETTERS = Path(__file__).parents[2] / "shared" / "data" / "strokes"
t = np.linspace(0, 1, 200)
ARC = resample(np.stack([300 * t, 80 * np.sin(np.pi * t)], axis=1), 200)
SPACE = resample(np.stack([0.5 * t, 0.2 * np.sin(np.pi * t), 0.15 * np.sin(4 * t)], axis=1), 200)


def letters():
    if not LETTERS.is_dir():
        pytest.skip("the letters drawn by people are not here")
    for path in sorted(LETTERS.glob("*.mat")):
        demonstrations = loadmat(path)["demos"][0]
        yield [one["pos"][0, 0].T for one in demonstrations]


def test_a_person_s_letters_have_the_default_faults():
    people = [measure(strokes) for strokes in letters()]
    found = {name: np.mean([one[name] for one in people]) for name in PARTS}
    # Found: offset 0.0317, size 0.0461, smooth 0.0335 (0.0352 as a root mean square over letters), ends 0.0376.
    assert found == pytest.approx({"offset": 0.0317, "size": 0.0461, "smooth": 0.0335, "ends": 0.0376}, abs=0.001)
    for name in PARTS:
        assert found[name] == pytest.approx(getattr(Hand(), name), rel=0.13)


def test_a_person_s_letters_differ_from_each_other_in_waves_as_the_fit_takes_them_to():
    waves = np.cos(np.pi * np.arange(24)[:, None] * t) / len(t)
    found, taken = [], []
    for strokes in letters():
        curves = np.stack([resample(stroke, len(t)) for stroke in strokes])
        letter = curves.mean(axis=0)
        found.append(((waves @ (curves - letter)) ** 2).sum(axis=(0, 2)) / (len(curves) - 1) / extent(letter) ** 2)
        taken.append(sum(np.diag(waves @ one @ waves.T) for one in hand_faults(letter)) / extent(letter) ** 2)
    ratio = np.mean(found, axis=0) / np.mean(taken, axis=0)
    bands = [ratio[low:high].mean() for low, high in ((0, 4), (4, 8), (8, 16), (16, 24))]
    assert 0.5 < min(bands) and max(bands) < 2.0, bands


def test_letters_of_the_simulated_hand_have_its_faults():
    for number, strokes in enumerate(letters()):
        letter = mean_curve(strokes)
        found = measure(letter + faults(letter, Hand(), 200, np.random.default_rng(number)))
        assert found == pytest.approx({name: getattr(Hand(), name) for name in PARTS}, rel=0.2)


@pytest.mark.parametrize("curve", [ARC, SPACE], ids=["in the plane", "in space"])
def test_measuring_the_simulated_hand_gives_its_parameters(curve):
    found = measure(curve + faults(curve, Hand(), 500, np.random.default_rng(3)))
    assert found == pytest.approx({name: getattr(Hand(), name) for name in PARTS}, rel=0.12)


def test_a_motion_in_space_has_as_much_fault_along_each_axis_as_a_drawing():
    for curve in (ARC, SPACE):
        moved = faults(curve, Hand(), 2000, np.random.default_rng(0)).mean(axis=1) / extent(curve)
        np.testing.assert_allclose(moved.std(axis=0), Hand().offset / np.sqrt(2), rtol=0.25)
        np.testing.assert_allclose(moved.std(axis=0), moved.std(), rtol=0.1)


def test_measure_recovers_known_offsets_and_sizes():
    arms = ARC - ARC.mean(axis=0)
    repetitions = [ARC + [3, 4], ARC - [3, 4], ARC + 0.1 * arms, ARC - 0.1 * arms]
    found = measure(repetitions)
    unbiased = np.sqrt(4 / 3)
    assert found["offset"] == pytest.approx(unbiased * np.sqrt(25 / 2) / 300, rel=1e-6)
    assert found["size"] == pytest.approx(unbiased * np.sqrt(0.1**2 / 2), rel=1e-6)
    assert found["smooth"] == pytest.approx(0, abs=1e-9)


def test_measuring_is_free_of_scale():
    repetitions = ARC + faults(ARC, Hand(), 6, np.random.default_rng(0))
    assert measure(7 * repetitions) == pytest.approx(measure(repetitions))


def test_a_hand_without_faults_repeats_the_curve():
    np.testing.assert_allclose(faults(ARC, scaled(Hand(), 0.0), 3, np.random.default_rng(0)), 0, atol=1e-9)


def test_faults_are_smooth():
    deviation = faults(ARC, Hand(), 20, np.random.default_rng(0))
    assert np.abs(np.diff(deviation, axis=1)).max() < 0.1 * np.abs(deviation).max()


def test_the_same_seed_gives_the_same_faults():
    first, second = (faults(ARC, Hand(), 2, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_a_curve_along_one_axis_has_finite_faults():
    line = np.stack([np.linspace(0, 100, 200), np.zeros(200)], axis=1)
    deviation = faults(line, Hand(), 50, np.random.default_rng(0))
    assert np.isfinite(deviation).all()
    assert np.abs(deviation).max() < 30


def test_own_speed_is_monotone_from_zero_to_one():
    times = own_speed(200, 0.6, 6, np.random.default_rng(0))
    assert times[0] == 0 and times[-1] == 1
    assert (np.diff(times) > 0).all()


def test_own_log_speed_has_its_deviation_at_the_knots():
    rng = np.random.default_rng(1)
    log_speeds = []
    for _ in range(800):
        speed = 1 / np.gradient(own_speed(501, 0.5, 6, rng))
        log_speeds.append(np.log(speed[100:401:100]))  # the inner knots
    between = np.array(log_speeds)
    between -= between.mean(axis=1, keepdims=True)  # the duration sets the level
    assert between.std() * np.sqrt(4 / 3) == pytest.approx(0.5, rel=0.1)


def test_no_deviation_of_speed_is_uniform_speed():
    np.testing.assert_allclose(own_speed(50, 0.0, 6, np.random.default_rng(0)), np.linspace(0, 1, 50))


def test_tremor_has_its_rms_and_duration():
    times = np.arange(0, 400, 0.01)
    trembling = tremor(times, 2.0, 0.04, np.random.default_rng(0))
    assert np.sqrt((trembling**2).sum(axis=1).mean()) == pytest.approx(2.0, rel=0.03)
    # White noise smoothed by a Gaussian of deviation s has the correlation exp(-lag^2 / 4 s^2).
    later = (trembling[:-8] * trembling[8:]).sum() / (trembling**2).sum()
    assert later == pytest.approx(np.exp(-(0.08**2) / (4 * 0.04**2)), abs=0.03)


@pytest.mark.parametrize(
    "wrong",
    [{"offset": -0.1}, {"tremor": float("nan")}, {"intent_share": 1.5}, {"rate": 0.0}, {"duration": (0.0, 1.0)}],
)
def test_an_impossible_hand_is_refused(wrong):
    with pytest.raises(ValueError, match="a hand"):
        Hand(**wrong)
