from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach.basis import Periodic, SquaredExponential
from teach.density import Flow, JointFlow
from teach.hull import visual_hull
from teach.raytrace import Algorithm1
from teach.rptl import fit
from teach.sketch import Event, Sketch, SketchError, Stroke
from teach.trajectory import Skill

TARGET = np.array([0.5, 0.0, 0.4])
EYES = ((-0.3, -0.9, 0.9), (-0.3, 0.9, 0.7), (0.2, 0.2, 1.6))
CAMERAS = [Camera.from_fov(look_at(eye, TARGET), 640, 480, 55) for eye in EYES]
S = np.linspace(0, 1, 150)
QUICK = Flow(steps=120)


def reach(s):
    return TARGET + np.stack([0.3 * s - 0.15, 0.12 * np.sin(3 * s) - 0.06, 0.15 * np.cos(2.5 * s)], axis=-1)


def sketches(deviations=(0, 0, 0), views=2):
    """Each view shows the curve once for each deviation (its size [m] along z, shrinking towards the end)."""
    drawn = []
    for number, camera in enumerate(CAMERAS[:views]):
        lines = [reach(S) + np.stack([0 * S, 0 * S, d * (1 - 0.5 * S)], axis=1) for d in deviations]
        strokes = tuple(Stroke(camera.project(x), 3 * S, k) for k, x in enumerate(lines))
        drawn.append(Sketch(f"v{number}", camera, strokes))
    return drawn


def furthest(a, b):
    """Largest distance [m] of points of curve a from curve b."""
    return np.linalg.norm(a[:, None] - b[None], axis=-1).min(axis=1).max()


@pytest.fixture(scope="module")
def skill():
    return fit(sketches((-0.01, 0, 0.01)), density=QUICK)


def test_two_exact_sketches_recover_the_curve_within_millimetres():
    mean = fit(sketches(), density=QUICK).distribution.mean_at(S)
    assert furthest(mean, reach(np.linspace(0, 1, 1000))) < 0.005
    assert mean_distance(mean, reach(np.linspace(0, 1, 1000))) < 0.002
    assert np.linalg.norm(mean[[0, -1]] - reach(S)[[0, -1]], axis=1).max() < 0.006


def test_three_views_use_all_pairs():
    skill = fit(sketches(views=3), density=Flow(steps=60))
    assert furthest(skill.distribution.mean_at(S), reach(np.linspace(0, 1, 1000))) < 0.006
    assert list(skill.report["reprojection_px"]) == ["v0", "v1", "v2"]


def test_densities_of_three_views_are_of_strokes_that_spread_as_all_views_say():
    spreads = {True: [], False: []}

    class Recording(Flow):
        def fit(self, strokes, size, *, seed=0):
            spreads[pooled].append(np.std(strokes - strokes.mean(axis=0)) / np.ptp(strokes.mean(axis=0), axis=0).max())
            return super().fit(strokes, size, seed=seed)

    close, far, further = sketches((-0.006, 0, 0.006), 1) + sketches((-0.012, 0, 0.012), 3)[1:]
    for pooled in spreads:
        fit([close, far, further], density=Recording(steps=20), pooled=pooled)
    alone, alike = spreads[False], spreads[True]
    assert len(alike) == 3 and min(alone) < min(alike) < max(alike) < max(alone)
    assert np.ptp(np.log(alike)) < 0.5 * np.ptp(np.log(alone))


def test_densities_of_two_views_are_of_the_strokes_as_they_are():
    close, far = sketches((-0.006, 0, 0.006), 1) + sketches((-0.012, 0, 0.012))[1:]
    means = [fit([close, far], density=QUICK, pooled=pooled).distribution.mean for pooled in (True, False)]
    np.testing.assert_array_equal(*means)


def test_samples_spread_as_the_strokes_do(skill):
    spread = skill.distribution.sample(500, [0.1, 0.5, 0.9], np.random.default_rng(0)).std(axis=0)
    assert (spread[:, 2] > 0.003).all() and (spread < 0.02).all()


def test_samples_are_as_smooth_as_a_hand_and_not_as_noise(skill):
    d, t = skill.distribution, np.linspace(0, 1, 101)
    deviation = d.sample(50, t, np.random.default_rng(0)) - d.mean_at(t)
    step = np.linalg.norm(np.diff(deviation, axis=1), axis=-1).mean()
    assert step < 0.15 * np.linalg.norm(deviation, axis=-1).mean()


def test_the_start_may_be_set(skill):
    start = reach(0.0) + [0, 0, 0.03]
    conditioned = skill.distribution.condition(0, start)
    assert np.abs(conditioned.sample(5, [0], np.random.default_rng(0)) - start).max() < 1e-6


def test_the_report_says_what_a_person_wants_to_know(skill):
    report = skill.report
    assert report["seconds"] > 0 and max(report["reprojection_px"].values()) < 2
    assert len(report["intersections"]) == 100 and min(report["intersections"]) > 0
    assert 45 < report["ray_angle_deg"] < 90 and report["warnings"] == []


def test_the_skill_lasts_as_long_as_the_strokes_and_can_be_saved(skill, tmp_path):
    assert skill.duration == 3
    skill.save(tmp_path / "skill.npz")
    assert Skill.load(tmp_path / "skill.npz").report == skill.report


def test_the_same_seed_gives_the_same_skill():
    a, b = (fit(sketches((-0.01, 0.01)), seed=3, density=Flow(steps=20)) for _ in range(2))
    assert np.array_equal(a.distribution.mean, b.distribution.mean)


def test_equal_arc_length_is_not_the_same_moment_where_views_foreshorten_differently():
    skills = [fit(sketches(), density=Flow(steps=20), time=time) for time in ("aligned", "arc_length")]
    aligned, equal = (skill.distribution.mean_at(S) for skill in skills)
    truth = reach(np.linspace(0, 1, 1000))
    assert furthest(equal, truth) > 5 * furthest(aligned, truth)


def test_the_papers_choices_work_together():
    skill = fit(
        sketches((-0.01, 0, 0.01)),
        density=JointFlow(hidden=64, transforms=4, steps=300, noise=0.01, learning_rate=3e-3),
        raytrace=Algorithm1(grid=100, adaptive=False, samples=150, delta=0.01),
        covariance="diagonal",
    )
    assert furthest(skill.distribution.mean_at(S), reach(np.linspace(0, 1, 1000))) < 0.03
    assert np.count_nonzero(skill.distribution.covariance - np.diag(np.diag(skill.distribution.covariance))) == 0


def test_events_and_outlines_of_regions_reach_the_skill():
    drawn = sketches()
    around = [Stroke(camera.project(TARGET + np.stack([0.1 * np.sin(7 * S), 0.1 * np.cos(7 * S), 0 * S], axis=1)),
                     S, kind="keep_out") for camera in CAMERAS]  # fmt: skip
    marked = Stroke(drawn[0].strokes[0].points, 3 * S, events=(Event("gripper_close", 1.5),))
    views = [Sketch("v0", CAMERAS[0], (marked, around[0])), drawn[1], Sketch("v2", CAMERAS[2], around[2:])]
    skill = fit(views, density=Flow(steps=20))
    assert skill.events[0].name == "gripper_close" and 0.3 * 3 < skill.events[0].time < 0.7 * 3
    assert [sketch.view for sketch in skill.keep_out] == ["v0", "v2"]
    (region,) = visual_hull(skill.keep_out)
    assert skill.report["keep_out"] == {"keep-out region": 1e3 * region.volume} and region.contains(TARGET)


def test_an_outline_that_bounds_no_region_is_refused_before_anything_is_learned():
    first, second = sketches()
    outline = Stroke([[10, 10], [50, 10], [50, 50], [10, 11]], [0, 1, 2, 3], kind="keep_out")
    with pytest.raises(SketchError, match="outlined only on view 'v0'"):
        fit([replace(first, strokes=(*first.strokes, outline)), second], density=None, raytrace=lambda *_: 1 / 0)


def test_what_is_marked_twice_on_a_stroke_happens_twice():
    drawn, (a, b) = sketches(), sketches()[0].strokes[:2]
    pauses = [(Event("pause", 0.6), Event("gripper_close", 1.5), Event("pause", 2.4)), (Event("pause", 0.7), Event("pause", 2.3))]
    marked = tuple(Stroke(stroke.points, 3 * S, events=events) for stroke, events in zip((a, b), pauses))
    skill = fit([Sketch("v0", CAMERAS[0], marked), drawn[1]], density=Flow(steps=20))
    assert [event.name for event in skill.events] == ["pause", "gripper_close", "pause"]
    assert skill.events[0].time < 1.2 and skill.events[2].time > 1.8


def test_warnings_are_sentences_about_what_was_drawn():
    first, second = sketches()
    cropped = Camera(first.camera.K, first.camera.world_from_camera, 320, 480)
    single = Sketch("v0", cropped, first.strokes[:1])
    warnings = fit([single, second], density=Flow(steps=20)).report["warnings"]
    assert any("View v0 has one stroke" in sentence for sentence in warnings)
    assert any("of what is drawn on view v0 lies outside the picture" in sentence for sentence in warnings)


def test_sketches_that_cannot_be_fitted_are_refused():
    with pytest.raises(SketchError, match="only on view"):
        fit(sketches()[:1])
    with pytest.raises(SketchError, match="never cross well"):
        fit([sketches()[0], Sketch("again", CAMERAS[0], sketches()[0].strokes)])
    with pytest.raises(ValueError, match="covariance"):
        fit(sketches(), covariance="round")
    with pytest.raises(ValueError, match="time"):
        fit(sketches(), time="later")
    with pytest.raises(SketchError, match="meet at"):
        fit(sketches(), density=Flow(steps=5), raytrace=Algorithm1(near=5.0, far=6.0))


def mean_distance(a, b):
    """Mean distance [m] of points of curve a from curve b."""
    return np.linalg.norm(a[:, None] - b[None], axis=-1).min(axis=1).mean()


def wipe(turns):
    """Points (T, 3) [m] of a tilted circle so many turns from its start."""
    angle = 2 * np.pi * np.asarray(turns)
    return TARGET + 0.12 * np.stack([np.cos(angle), 0.8 * np.sin(angle), 0.6 * np.sin(angle)], axis=-1)


def wiped(counts=(3, 3), durations=(3.0, 6.0), noise=1.0, seed=0):
    """Each view shows the circle so many times round, at a speed that goes up and down."""
    rng, drawn = np.random.default_rng(seed), []
    for camera, count, duration in zip(CAMERAS[1:], counts, durations, strict=True):
        speed = np.exp(np.interp(np.linspace(0, 1, 900), np.linspace(0, 1, 7), rng.normal(0, 0.4, 7)))
        turns = count * (np.cumsum(speed) - speed[0]) / (speed.sum() - speed[0])
        points = camera.project(wipe(turns)) + noise * rng.standard_normal((900, 2))
        drawn.append(Sketch(f"v{len(drawn)}", camera, (Stroke(points, np.linspace(0, duration, 900)),)))
    return drawn


@pytest.fixture(scope="module")
def wiping():
    return fit(wiped(), density=Flow(steps=40))


def test_a_circle_drawn_round_and_round_is_recovered_within_millimetres_and_closes(wiping):
    mean, truth = wiping.distribution.mean_at(S), wipe(np.linspace(0, 1, 1000))
    assert furthest(mean, truth) < 0.006 and mean_distance(mean, truth) < 0.003
    samples = wiping.distribution.sample(10, [0, 1, 0.1, 1.1], np.random.default_rng(0))
    assert np.allclose(samples[:, [0, 2]], samples[:, [1, 3]], atol=1e-9)


def test_one_turn_is_the_skill_and_the_report_says_how_many_were_drawn(wiping, tmp_path):
    assert wiping.report["turns"] == 3 and 1 < wiping.duration < 2
    wiping.save(tmp_path / "skill.npz")
    assert Skill.load(tmp_path / "skill.npz").distribution.basis == SquaredExponential().wrapped()


def test_views_may_show_different_numbers_of_turns():
    skill = fit(wiped((2, 5), (2.0, 5.0)), density=Flow(steps=20))
    assert mean_distance(skill.distribution.mean_at(S), wipe(np.linspace(0, 1, 1000))) < 0.005
    assert skill.report["turns"] == 3.5 and np.isclose(skill.duration, 1, rtol=0.2)


def test_motions_drawn_once_are_periodic_only_if_asked_for(skill):
    assert "turns" not in skill.report and skill.distribution.basis.period is None
    once, quick = wiped((1, 1), noise=0), {"density": Flow(steps=5)}
    assert fit(once, **quick).distribution.basis.period is None
    for settings in ({"periodic": True}, {"basis": Periodic(15)}):
        skill = fit(once, **quick, **settings)
        assert skill.report["turns"] == 1 and skill.distribution.basis.period == 1
    assert fit(wiped(), **quick, periodic=False).distribution.basis.period is None
    with pytest.raises(SketchError, match="does not go round"):
        fit(sketches(), periodic=True)


TILT = np.array([-0.3, 0.2, 1.0]) / np.linalg.norm([-0.3, 0.2, 1.0])


def board(camera):
    """Depth picture of the plane with normal TILT through the target, noisy by 3 mm."""
    origins, directions = camera.rays(camera.pixel_centres())
    z = ((TARGET - origins) @ TILT) / (directions @ TILT) * (directions @ camera.forward)
    return z + 0.003 * np.random.default_rng(0).standard_normal(z.shape)


def letter(s):
    """A letter-like line on that plane."""
    x, y = 0.08 * np.sin(6 * s), 0.3 * s - 0.15
    return TARGET + np.stack([x, y, -(TILT[0] * x + TILT[1] * y) / TILT[2]], axis=-1)


def written(camera=CAMERAS[0]):
    """The letter written three times in one view, a few millimetres beside each other."""
    across = np.cross(TILT, [1.0, 0.0, 0.0])
    lines = [camera.project(letter(S) + d * across * (1 - 0.5 * S[:, None])) for d in (-0.005, 0.0, 0.005)]
    return Sketch("v0", camera, tuple(Stroke(pixels, 3 * S, k) for k, pixels in enumerate(lines)))


@pytest.mark.parametrize("offset", [0.0, 0.05])
def test_a_letter_written_on_one_view_is_learned_on_the_surface_or_above_it(offset):
    skill = fit([written()], depths={"v0": board(CAMERAS[0])}, offset=offset)
    mean = skill.distribution.mean_at(S)
    assert furthest(mean, letter(np.linspace(0, 1, 2000)) + offset * TILT) < 0.003
    assert np.abs((mean - TARGET) @ TILT - offset).max() < 0.002
    assert skill.report["surface"]["offset_m"] == offset and "on view v0 alone" in skill.report["warnings"][0]


def test_all_times_and_covariances_can_be_had_on_a_surface():
    for choice in ({"time": "drawn"}, {"time": "arc_length"}, {"covariance": "diagonal"}):
        skill = fit([written()], depths={"v0": board(CAMERAS[0])}, **choice)
        assert np.abs((skill.distribution.mean_at(S) - TARGET) @ TILT).max() < 0.002


def test_a_skill_on_a_surface_is_saved_with_its_report(tmp_path):
    skill = fit([written()], depths={"v0": board(CAMERAS[0])})
    skill.save(tmp_path / "skill.npz")
    assert Skill.load(tmp_path / "skill.npz").report == skill.report


def test_one_view_needs_its_own_depth():
    with pytest.raises(SketchError, match="only on view 'v0'.*depth picture of that view.*surface"):
        fit([written()])
    with pytest.raises(SketchError, match="only on view 'v0'"):
        fit([written()], depths={"v1": board(CAMERAS[1])})


def approaching(*events):
    """Two views of a motion from above down to the plane, whose strokes end 4 pixels here or there."""
    rng, s = np.random.default_rng(1), S[:, None]
    path = letter(0.8) + (1 - s) * [-0.15, -0.1, 0.2] + np.sin(np.pi * s) * [0.0, 0.05, 0.03]
    return [
        Sketch(f"v{number}", camera, tuple(
            Stroke(camera.project(path) + s * rng.normal(0, 4, 2), 3 * S, k, events=events) for k in range(3)))
        for number, camera in enumerate(CAMERAS[:2])
    ]  # fmt: skip


def test_contacts_end_the_motion_on_the_surface_though_the_strokes_ends_are_noisy():
    depths = {f"v{number}": board(camera) for number, camera in enumerate(CAMERAS[:2])}
    free, touching = (fit(approaching(*events), density=QUICK, depths=depths) for events in ((), (Event("contact", 3.0),)))
    above, end = ((skill.distribution.mean_at(1.0)[0] - TARGET) @ TILT for skill in (free, touching))
    assert abs(above) > 0.002 > abs(end)
    assert np.linalg.norm(touching.distribution.mean_at(1.0)[0] - letter(0.8)) < 0.015
    assert [(event.name, event.time) for event in touching.events] == [("contact", touching.duration)]
    (contact,) = touching.report["contacts"]
    assert contact["views"] == ["v0", "v1"] and free.report["contacts"] == []


def test_an_offset_that_cannot_be_used_is_told():
    warnings = fit(approaching(), density=Flow(steps=20), offset=0.02).report["warnings"]
    assert any("offset is not used" in sentence for sentence in warnings)


def test_contacts_without_a_depth_picture_remain_events_and_are_told():
    skill = fit(approaching(Event("contact", 3.0)), density=Flow(steps=20))
    assert [event.name for event in skill.events] == ["contact"] and skill.report["contacts"] == []
    assert any("depth picture is missing" in sentence for sentence in skill.report["warnings"])


LETTERS = Path(__file__).parents[2] / "shared" / "data" / "strokes"


@pytest.mark.slow
@pytest.mark.skipif(not LETTERS.exists(), reason="letters drawn by a person are not here")
@pytest.mark.parametrize("letter", "CGJNSW")
def test_letters_drawn_by_a_person_are_learned_nearly_as_well_as_their_paths_in_space_allow(letter):
    from scipy.io import loadmat

    from teach.metrics import mfd, wd

    board = np.array([0.55, 0.0, 0.45])
    strokes = [loadmat(LETTERS / f"{letter}.mat")["demos"][0, k]["pos"][0, 0].T * 0.30 / 18 for k in range(9)]
    paths = [board + np.column_stack([0 * x[:, 0], -x[:, 0], x[:, 1]]) for x in strokes]
    eyes = ((-0.25, -0.75, 0.75), (-0.25, 0.75, 0.75), (-0.45, 0.05, 0.40))
    cameras = [Camera([[550, 0, 320], [0, 550, 240], [0, 0, 1]], look_at(eye, board), 640, 480) for eye in eyes]
    drawn = [Sketch(f"v{v}", c, tuple(Stroke(c.project(x), np.linspace(0, 2, 200)) for x in paths[3 * v : 3 * v + 3]))
             for v, c in enumerate(cameras)]
    distribution = fit(drawn[:2]).distribution
    held, see = [stroke.points for stroke in drawn[2].strokes], cameras[2].project
    t = np.linspace(0, 1, 200)
    oracle = np.stack([Stroke(x[:, 1:], np.arange(200)).at(t) for x in paths[:6]])
    oracle = np.concatenate([np.full((6, 200, 1), 0.55), oracle], axis=2)
    assert mfd(see(distribution.mean_at(t)), held, 640)[0] < 1.3 * mfd(see(oracle.mean(axis=0)), held, 640)[0]
    rng = np.random.default_rng(0)
    ours = np.mean([wd(see(distribution.sample(5, t, rng)), held, 640) for _ in range(5)])
    assert ours < 1.4 * wd(see(oracle[:5]), held, 640)
