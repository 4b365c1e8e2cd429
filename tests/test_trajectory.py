import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scene.camera import Camera, look_at
from teach.basis import Periodic, SquaredExponential
from teach.sketch import Event, Sketch, Stroke
from teach.trajectory import Route, Skill, TrajectoryDistribution

T = np.linspace(0, 1, 21)


def distribution(rank=30, count=10, seed=0, scale=0.05):
    rng = np.random.default_rng(seed)
    L = scale * rng.standard_normal((3 * count, rank))
    return TrajectoryDistribution(SquaredExponential(count), rng.standard_normal((count, 3)), L @ L.T)


def test_samples_have_the_mean_and_covariance_that_are_stated():
    d, rng = distribution(), np.random.default_rng(1)
    samples = d.sample(20_000, T, rng)
    assert samples.shape == (20_000, 21, 3)
    deviation = np.sqrt(np.trace(d.covariance_at(T), axis1=1, axis2=2))
    assert (np.abs(samples.mean(axis=0) - d.mean_at(T)).max(axis=1) < 0.05 * deviation).all()
    for k in (0, 10, 20):
        assert np.allclose(np.cov(samples[:, k].T), d.covariance_at(T)[k], atol=0.05 * deviation[k] ** 2)


def test_features_make_the_trajectory_of_the_flattened_weights():
    d = distribution()
    assert np.allclose((d.features(T) @ d.mean.ravel()).reshape(-1, 3), d.mean_at(T))
    assert np.allclose(d.features([0.3]) @ d.covariance @ d.features([0.3]).T, d.covariance_at(0.3)[0])


def test_log_prob_is_the_normal_density():
    d = distribution()
    C, offset = d.covariance_at(0.4)[0], np.array([0.1, -0.2, 0.05])
    expected = -0.5 * offset @ np.linalg.inv(C) @ offset - 0.5 * np.log(np.linalg.det(2 * np.pi * C))
    assert np.isclose(d.log_prob([0.4], d.mean_at(0.4) + offset)[0], expected)


def test_conditioning_is_the_closed_form():
    d, x, R = distribution(), np.array([0.3, 0.2, 0.1]), 0.01 * np.eye(3)
    H, S = d.features([0.3]), d.covariance
    K = S @ H.T @ np.linalg.inv(H @ S @ H.T + R)
    c = d.condition(0.3, x, R, local=False)
    assert np.allclose(c.mean.ravel(), d.mean.ravel() + K @ (x - H @ d.mean.ravel()))
    assert np.allclose(c.covariance, S - K @ H @ S)
    near = d.sample(1, [0.3], np.random.default_rng(0))[0, 0]  # what the distribution explains needs no bump
    assert np.array_equal(d.condition(0.3, near).mean, d.condition(0.3, near, local=False).mean)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), rank=st.sampled_from([1, 2, 5, 30]), scale=st.sampled_from([1e-3, 0.05, 3.0]))
def test_conditioned_start_via_and_goal_are_met_exactly_even_by_a_singular_covariance(seed, rank, scale):
    d = distribution(rank, seed=seed, scale=scale)
    rng = np.random.default_rng(seed)
    t, x = np.array([0.0, 0.45, 1.0]), rng.uniform(-1, 1, (3, 3))
    c = d.condition(t, x)
    assert np.abs(c.mean_at(t) - x).max() < 1e-8
    rounding = np.sqrt(np.finfo(float).eps * np.linalg.eigvalsh(d.covariance).max())  # of a deviation, as S is what is stored
    assert np.abs(c.sample(20, t, rng) - x).max() < max(1e-7, 4 * rounding)
    assert np.linalg.eigvalsh(c.covariance).min() > -1e-9 * scale**2


@pytest.mark.parametrize("basis", [SquaredExponential(20, 50.0), Periodic(20)])
def test_a_start_far_away_moves_the_start_and_not_the_rest(basis):
    wide = np.ones((20, 20)) / 400 + 0.2 * np.eye(20)  # strokes that start high end high
    d = TrajectoryDistribution(basis, np.zeros((20, 3)), 1e-4 * np.kron(wide, np.eye(3)))
    t, away = np.linspace(0, 1, 101), np.array([0.06, 0, 0.08])
    moved = np.linalg.norm(d.condition(0, away).mean_at(t), axis=1)
    rest = slice(20, 81 if basis.period else None)
    assert moved[0] == pytest.approx(0.1, abs=1e-6) and moved[rest].max() < 0.01
    steps = [np.linalg.norm(d.condition(0, away * k).mean_at(0.5)) for k in np.linspace(0, 1, 30)]
    assert np.abs(np.diff(steps)).max() < 0.002  # no jump where a point becomes unlikely


def test_an_ill_conditioned_covariance_is_met_one_after_the_other_too():
    basis = SquaredExponential(20)
    S = np.linalg.pinv(np.kron(basis(T).T @ basis(T), np.eye(3)), rcond=1e-6) * 1e-4
    d = TrajectoryDistribution(basis, np.zeros((20, 3)), S)
    c = d.condition(0, [0.1, 0, 0]).condition(1, [0, 0.1, 0]).condition(0.5, [0, 0, 0.1])
    expected = 0.1 * np.eye(3)[[0, 1, 2]]
    assert np.abs(c.mean_at([0, 1, 0.5]) - expected).max() < 1e-6
    assert np.abs(c.sample(10, [0, 1, 0.5], np.random.default_rng(0)) - expected).max() < 1e-6


def test_a_condition_with_covariance_lies_between_the_distribution_and_the_point():
    d = distribution()
    x = d.mean_at(0.5)[0] + 0.1
    loose, tight = (np.linalg.norm(d.condition(0.5, x, v * np.eye(3)).mean_at(0.5) - x) for v in (10.0, 1e-6))
    assert loose > 0.9 * np.linalg.norm([0.1] * 3) and tight < 1e-3


def test_contradicting_or_malformed_conditions_are_refused():
    d = distribution()
    with pytest.raises(ValueError, match="contradict"):
        d.condition([0.5, 0.5], [[0, 0, 0], [0, 0, 1]])
    with pytest.raises(ValueError, match="conditioned"):
        d.condition([0.5, 0.6], [0, 0, 0])
    with pytest.raises(ValueError, match="finite"):
        d.condition(0.5, [0, np.nan, 0])


def test_the_first_weight_alone_makes_the_papers_start():
    d, x = distribution(), np.array([0.4, 0.1, 0.2])
    c = d.with_first_weight(x)
    assert np.allclose(c.mean_at(0)[0], x) and np.array_equal(c.mean[1:], d.mean[1:])
    assert np.abs(c.sample(10, [0], np.random.default_rng(0)) - x).max() < 1e-6
    W = d.sample_weights(5000, np.random.default_rng(1))  # the paper's procedure, sample by sample
    Phi = d.basis(0)[0]
    W[:, 0] = (x - np.einsum("m,nma->na", Phi[1:], W[:, 1:])) / Phi[0]
    at = d.basis(0.1) @ W
    assert np.allclose(np.cov(at[:, 0].T), c.covariance_at(0.1)[0], atol=0.1 * np.trace(c.covariance_at(0.1)[0]))


def test_shapes_and_symmetry_are_checked():
    basis = SquaredExponential(4)
    with pytest.raises(ValueError, match=r"mean \(4, 3\)"):
        TrajectoryDistribution(basis, np.zeros((3, 3)), np.eye(12))
    with pytest.raises(ValueError, match="symmetric"):
        TrajectoryDistribution(basis, np.zeros((4, 3)), np.triu(np.ones((12, 12))))
    with pytest.raises(ValueError, match="finite"):
        TrajectoryDistribution(basis, np.full((4, 3), np.nan), np.eye(12))


def test_a_skill_is_read_back_as_it_was_saved(tmp_path):
    camera = Camera.from_fov(look_at((0, -1, 1), (0, 0, 0)), 640, 480, 60)
    outline = Sketch("a", camera, (Stroke([[0, 0], [1, 1]], [0, 1], kind="keep_out"),))
    orientation = np.array([[0.0, 0, 0, 0, 1], [1.0, 1, 0, 0, 0]])
    report = {"warnings": ["Draw again."]}
    skill = Skill(distribution(), 2.5, (Event("gripper_close", 1.2),), orientation, (outline,), report)
    skill.save(tmp_path / "skill.npz")
    back = Skill.load(tmp_path / "skill.npz")
    assert np.array_equal(back.distribution.mean, skill.distribution.mean)
    assert np.array_equal(back.distribution.covariance, skill.distribution.covariance)
    assert (back.distribution.basis, back.duration, back.events) == (skill.distribution.basis, 2.5, skill.events)
    assert np.array_equal(back.orientation, orientation) and back.report == skill.report
    assert back.keep_out[0].strokes[0].kind == "keep_out"
    assert [file.name for file in tmp_path.iterdir()] == ["skill.npz"]


def test_other_files_are_not_skills(tmp_path):
    with pytest.raises(FileNotFoundError):
        Skill.load(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("not a zip file")
    np.savez(tmp_path / "other.npz", a=1)
    np.savez(tmp_path / "pickled.npz", text=np.array([{}], dtype=object))
    for name in ("text.npz", "other.npz", "pickled.npz"):
        with pytest.raises(ValueError, match="not a skill file"):
            Skill.load(tmp_path / name)


def periodic(kappa=2.7):
    d = distribution(count=12)
    return TrajectoryDistribution(Periodic(12, kappa), d.mean, d.covariance)


def test_a_periodic_motion_ends_where_it_starts_also_when_it_is_made_to_start_elsewhere():
    x, rng = np.array([0.1, 0.2, 0.3]), np.random.default_rng(0)
    for d in (periodic().condition([0, 0.4], [x, 2 * x]), periodic().with_first_weight(x)):
        samples = d.sample(20, [0, 1, 0.1, 1.1], rng)
        assert np.abs(samples[:, :2] - x).max() < 1e-6 and np.allclose(samples[:, 2], samples[:, 3])
    with pytest.raises(ValueError, match="contradict"):
        periodic().condition([0, 1], [x, 2 * x])


def test_a_periodic_skill_is_read_back_as_it_was_saved(tmp_path):
    skill = Skill(periodic(), 1.5)
    skill.save(tmp_path / "skill.npz")
    back = Skill.load(tmp_path / "skill.npz").distribution
    assert back.basis == Periodic(12, 2.7)
    assert np.array_equal(back.sample(2, T, np.random.default_rng(0)), periodic().sample(2, T, np.random.default_rng(0)))


def rewritten(path, version, basis):
    """The skill file with another version and description of its basis."""
    with np.load(path) as file:
        arrays = dict(file)
    text = json.loads(str(arrays["text"])) | {"version": version, "basis": basis}
    np.savez(path, **arrays | {"text": json.dumps(text)})


def test_skills_of_the_first_version_which_name_no_kind_of_basis_are_still_read(tmp_path):
    Skill(distribution(), 2.5).save(tmp_path / "skill.npz")
    rewritten(tmp_path / "skill.npz", 1, {"count": 10, "gamma": 40.0})
    assert Skill.load(tmp_path / "skill.npz").distribution.basis == SquaredExponential(10, 40.0)


@pytest.mark.parametrize("version, basis, wrong", [(2, {"kind": "Wavelet", "count": 10}, "'Wavelet', known are Squared"),
                                                   (2, {"kind": "Periodic", "gamma": 50.0}, "gamma"),
                                                   (3, {"count": 10, "gamma": 50.0}, "version 3")])  # fmt: skip
def test_a_skill_of_an_unknown_basis_or_version_is_refused_in_a_line(tmp_path, version, basis, wrong):
    Skill(distribution(), 2.5).save(tmp_path / "skill.npz")
    rewritten(tmp_path / "skill.npz", version, basis)
    with pytest.raises(ValueError, match=f"not a skill file .*{wrong}") as error:
        Skill.load(tmp_path / "skill.npz")
    assert "\n" not in str(error.value)


def test_a_covariance_with_negative_variances_is_refused(tmp_path):
    Skill(distribution(), 2.5).save(tmp_path / "skill.npz")
    with np.load(tmp_path / "skill.npz") as file:
        arrays = dict(file)
    np.savez(tmp_path / "skill.npz", **arrays | {"covariance": -arrays["covariance"]})
    with pytest.raises(ValueError, match="not a skill file .*negative variances"):
        Skill.load(tmp_path / "skill.npz")


def test_the_ways_of_a_skill_are_kept_and_all_start_where_they_are_told(tmp_path):
    d = distribution()
    other = d.condition(0.5, [0.1, 0.2, 0.3])
    skill = Skill(d, 2.0, routes=(Route(0.75, d), Route(0.25, other)), conditioning="first_weight")
    skill.save(tmp_path / "skill.npz")
    loaded = Skill.load(tmp_path / "skill.npz")
    assert [way.share for way in loaded.ways] == [0.75, 0.25] and loaded.conditioning == "first_weight"
    assert np.array_equal(loaded.ways[1].distribution.covariance, other.covariance)
    start = np.array([0.3, 0.1, 0.2])
    for one in (loaded, replace(loaded, conditioning="gaussian")):
        for way in one.starting_at(start):
            assert np.abs(way.distribution.sample(3, [0.0], np.random.default_rng(0)) - start).max() < 1e-6
    assert np.array_equal(loaded.starting_at(start)[0].distribution.mean, d.with_first_weight(start).mean)
    assert [way.share for way in Skill(d, 1.0).ways] == [1.0]
    with pytest.raises(ValueError, match="gaussian"):
        Skill(d, 1.0, conditioning="wild")
