"""report.html: one self-contained page with a picture of each stage, made from the files of a run.

A stage that was not done has no section. Pictures also lie in figures/ beside the page.
"""

import base64
import html
import json
from pathlib import Path

import numpy as np

from conf import figures
from conf.stages import Job
from scene.dataset import load_frame, load_image, load_points, load_views
from scene.files import replacing
from scene.inputs import scene_name

TIMES = np.linspace(0, 1, 100)
SHOWN_SAMPLES = 8

STYLE = """
:root { color-scheme: light dark; --ink: #1f2328; --paper: #fff; --line: #d1d9e0; --muted: #59636e; --good: #1a7f37; --bad: #d1242f }
@media (prefers-color-scheme: dark) { :root { --ink: #e6edf3; --paper: #0d1117; --line: #3d444d; --muted: #9198a1; --good: #3fb950; --bad: #f85149 } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 68rem; margin: 2rem auto; padding: 0 1rem }
h1 { margin-bottom: 0 } h2 { margin: 2.5rem 0 .3rem; border-top: 1px solid var(--line); padding-top: 1rem }
p.verdict { font-size: 1.2rem; border-left: 5px solid var(--bad); padding-left: .8rem } p.verdict.good { border-color: var(--good) }
p.note, figcaption { color: var(--muted); margin: .2rem 0 } figure { margin: 1rem 0 }
img, video { max-width: 100%; border-radius: 4px; background: #fff }
table { border-collapse: collapse } td, th { text-align: left; padding: .15rem 1.2rem .15rem 0; vertical-align: top } td.number { text-align: right; font-variant-numeric: tabular-nums }
"""


def write_report(job: Job) -> Path:
    """Write report.html and figures/ into the run's folder; returns the page's path."""
    metrics = json.loads((job.run / "metrics.json").read_text())
    page = _Page(job)
    parts = [_head(job, metrics)]
    for section in (_photographs, _field, _surface, _sketches, _learned, _planned, _performed):
        parts += section(page, metrics)
    parts += ["<h2>All figures</h2>", _table(metrics), "</body></html>"]
    path = job.run / "report.html"
    with replacing(path) as temporary:
        temporary.write_text("\n".join(parts), encoding="utf-8")
    return path


class _Page:
    """The files of a job, and where its pictures go."""

    def __init__(self, job: Job):
        self.run, self.capture = job.run, job.capture
        self.rendered = job.cfg.user.get("draws_on") != "photographs"
        self.figures = job.run / "figures"
        self.figures.mkdir(exist_ok=True)

    def picture(self, name: str, figure, caption: str) -> str:
        path = self.figures / f"{name}.png"
        figure.savefig(path, dpi=110)
        return self.image(path, caption)

    def image(self, path: Path, caption: str) -> str:
        return f'<figure><img alt="{html.escape(caption)}" src="{_embed(path, "image/png")}"><figcaption>{html.escape(caption)}</figcaption></figure>'

    def video(self, path: Path, caption: str) -> str:
        source = _embed(path, "video/mp4")
        return f'<figure><video controls loop muted playsinline src="{source}"></video><figcaption>{html.escape(caption)}</figcaption></figure>'


def _head(job: Job, metrics: dict) -> str:
    name = "photographs of " + scene_name(job.cfg.photos) if job.cfg.photos else f"the {job.cfg.world.name} world"
    good, verdict = _verdict(metrics)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>scene2skill: {html.escape(name)}</title><style>{STYLE}</style></head><body>"
        f"<h1>scene2skill</h1><p class=note>{html.escape(name)}, seed {job.cfg.seed}, scene seed {job.cfg.scene.seed}; "
        f"{metrics['total_seconds']:.0f} s for all stages</p><p class='verdict {'good' if good else ''}'>{html.escape(verdict)}</p>"
    )


def _verdict(metrics: dict) -> tuple[bool, str]:
    """One sentence a person understands."""
    if "execute" in metrics:
        done = metrics["execute"]
        end = f"the hand ended {done['final_error_mm']:.0f} mm from where it was to go, with {done['contacts']} contacts"
        unmet = [name for name, condition in done["conditions"].items() if not condition["met"]]
        end += f"; not met: {', '.join(unmet)}" if unmet else ""
        return done["success"], f"{'The robot performed the sketched motion' if done['success'] else 'The motion failed'}: {end}."
    if "plan" in metrics:
        return metrics["plan"]["feasible"], "A feasible motion was planned." if metrics["plan"]["feasible"] else "No feasible motion: nothing was performed."
    if "field" in metrics:
        return True, f"The scene was learned: {metrics['field']['psnr']:.1f} dB on held-out photographs."
    return True, f"Stages done: {', '.join(name for name in metrics if name != 'total_seconds')}."


def _photographs(page: _Page, metrics: dict) -> list[str]:
    if "reconstruct" not in metrics:
        return []
    found, frame = metrics["reconstruct"], load_frame(page.capture)
    error = f", reprojection error {found['reprojection_px']:.2f} px" if "reprojection_px" in found else ""
    text = f"{found['registered']} of {found['total']} registered{error}; frame: {frame['name']}."
    figure = figures.photographs_and_cameras(load_views(page.capture), *load_points(page.capture))
    return ["<h2>Photographs and cameras</h2>", f"<p>{html.escape(text)}</p>",
            page.picture("cameras", figure, "Photographs; where they were taken, around the sparse points.")]  # fmt: skip


def _field(page: _Page, metrics: dict) -> list[str]:
    if "field" not in metrics:
        return []
    views = {view.name: view for view in load_views(page.capture)}
    shown = sorted((page.capture / "held_out").glob("*.png"))[:2]
    parts = ["<h2>The learned scene</h2>", f"<p>{metrics['field']['psnr']:.2f} dB on photographs that training never saw.</p>"]
    for i, path in enumerate(shown):
        depth = np.load(path.with_name(f"{path.stem}_depth.npy"))
        figure = figures.beside(views[path.stem].image, load_image(path), depth)
        parts.append(page.picture(f"held_out{i}", figure, f"{path.stem}: held out, rendered, and its depth."))
    for path in sorted((page.capture / "moved").glob("*.png"))[:4]:
        parts.append(page.image(path, f"{path.stem}: what is marked looks otherwise than in the other photographs. On the right the field."))
    orbit = page.capture / "views" / "orbit.mp4"
    return parts + ([page.video(orbit, "An orbit rendered from the field.")] if orbit.exists() else [])


def _surface(page: _Page, metrics: dict) -> list[str]:
    """The mesh, if one was made of the field that is shown: of another one it is not of this job."""
    drawn = page.capture / "mesh.png"
    if "surface" not in metrics or not drawn.exists():
        return []
    text = "{triangles} triangles, {pieces} convex pieces for planning; of the space around, {free:.0%} is free and {unseen:.0%} unseen."
    return ["<h2>Its surface</h2>", f"<p>{text.format(**metrics['surface'])}</p>",
            page.image(drawn, "The mesh, drawn in its colours from where an orbit around the photographs' focus begins.")]  # fmt: skip


def _sketches(page: _Page, metrics: dict) -> list[str]:
    if "sketch" not in metrics:
        return []
    drawn = [(title, image, strokes, outlines) for title, image, _, strokes, outlines in _drawn(page)]
    text = "Strokes as they were drawn; a circle marks each start. A held-out view is for evaluation only."
    if any(outlines for *_, outlines in drawn):
        text += " Dashed: outlines of regions to keep out of."
    return ["<h2>Sketches</h2>", page.picture("sketches", figures.sketches(drawn), text)]


def _drawn(page: _Page) -> list[tuple]:
    """(title, image, camera, strokes, outlines) of every sketched view, the held-out one last."""
    from teach import sketch

    images = _pictures(page)
    held_out = sketch.load(page.run / "held_out.json")
    rows = [(s.view, s) for s in sketch.load(page.run / "sketches.json")] + [(f"{s.view} (held out)", s) for s in held_out]
    blank = np.full((480, 640, 3), 255, np.uint8)
    return [(title, images.get(s.view, blank), s.camera, *([stroke.points for stroke in strokes] for strokes in (s.motions, s.outlines)))
            for title, s in rows]  # fmt: skip


def _pictures(page: _Page) -> dict[str, np.ndarray]:
    """Everything that may have been drawn on, by name; what the job draws on, photographs or rendered views, wins."""
    folders = [page.capture, page.capture / "views"]
    known = [{v.name: v.image for v in load_views(folder)} for folder in folders if (folder / "transforms.json").is_file()]
    return {name: image for images in (known if page.rendered else known[::-1]) for name, image in images.items()}


def _learned(page: _Page, metrics: dict) -> list[str]:
    if "teach" not in metrics:
        return []
    from teach.hull import visual_hull
    from teach.trajectory import Skill

    rng = np.random.default_rng(0)
    skill, start = Skill.load(page.run / "skill.npz"), _start(page)
    learned, regions = skill.distribution, visual_hull(skill.keep_out)
    conditioned = learned if start is None else skill.starting_at(start)[0].distribution
    counts = [max(round(SHOWN_SAMPLES * way.share), 1) for way in skill.ways]
    mean = learned.mean_at(TIMES)
    samples = np.concatenate([way.distribution.sample(n, TIMES, rng) for way, n in zip(skill.ways, counts, strict=True)])
    drawn = _drawn(page)
    pages = [(t, image, c.project(mean), c.project(samples), strokes) for t, image, c, strokes, _ in drawn]
    performed = _performed_path(page)
    seen = [] if performed is None else [c.project(performed) for _, _, c, *_ in drawn]
    sketched = [(t, image, strokes, outlines) for t, image, _, strokes, outlines in drawn[:2]]
    started = conditioned.sample(SHOWN_SAMPLES, TIMES, rng)
    variance = np.einsum("tii->ti", conditioned.covariance_at(TIMES))
    deviation = np.sqrt(np.maximum(variance, 0))  # rounding leaves -1e-18 where the start is exact
    edges = [region.edges for region in regions]
    parts = ["<h2>The learned motion</h2>", *_scores(metrics["teach"]), *_quality(page, skill.report), *_densities(page)]
    return parts + [
        page.picture("overview", figures.overview(sketched, pages[-1], _last_frame(page)),
                     "Sketched on two views, learned, performed."),
        page.picture("trajectories", figures.trajectories_3d(mean, samples, *_points(page), performed, edges),
                     "Samples (red) and mean (coloured by time) in the scene." + (" Blue: regions to keep out of." if edges else "")),
        page.picture("overlay", figures.overlay(pages, seen), "Samples (red) and mean (coloured by time) seen by each view; dotted: the strokes"
                     + ("; black: the performed path." if seen else ".")),
        page.picture("over_time", figures.over_time(TIMES, conditioned.mean_at(TIMES), deviation, started),
                     "Position over normalised time, conditioned to start at the hand (square), with two standard deviations."),
    ]  # fmt: skip


def _points(page: _Page) -> tuple[np.ndarray, np.ndarray]:
    """The scene's sparse points; none where it is known from truth."""
    known = (page.capture / "transforms.json").exists()
    return load_points(page.capture) if known else (np.empty((0, 3)), np.empty((0, 3), np.uint8))


def _quality(page: _Page, report: dict) -> list[str]:
    """What a person should know of the fit, and when the motion is known how well."""
    said = "".join(f"<li>{html.escape(sentence)}" for sentence in report.get("warnings", ()))
    parts = [f"<p>{html.escape(report['sentence'])}</p>"] if "sentence" in report else []
    parts += [f"<ul>{said}</ul>"] if said else []
    if "uncertainty_mm" not in report:
        return parts
    return parts + [page.picture("quality", figures.quality(report), "How far the motion's mean may be off (one standard deviation) and "
                                 "how far demonstrations vary; the angle at which rays of the views meet; shaded: draw again.")]  # fmt: skip


def _scores(teach: dict) -> list[str]:
    if "mfd" not in teach:
        return []
    rows = [("learned", ""), ("oracle: the intended paths themselves", "oracle_"), ("straight line", "linear_"), ("nearest view", "nearest_neighbour_")]
    cells = "".join(f"<tr><td>{name}<td class=number>{100 * teach[p + 'mfd']:.2f}<td class=number>{100 * teach[p + 'wd']:.2f}" for name, p in rows)
    return ["<p>Distance to the strokes of the held-out view, in % of the picture's width.</p>",
            f"<table><tr><th><th>mean Fréchet<th>Wasserstein{cells}</table>"]  # fmt: skip


def _densities(page: _Page) -> list[str]:
    path = page.run / "densities.npz"
    if not path.exists():
        return []
    kept = np.load(path, allow_pickle=False)
    pages = [(t, image, kept[t]) for t, image, *_ in _drawn(page) if t in kept]
    return [page.picture("densities", figures.densities(pages), "Density of the strokes in each view, all times together.")]


def _planned(page: _Page, metrics: dict) -> list[str]:
    if "plan" not in metrics:
        return []
    from robot.planner import Plan

    plan = Plan.load(page.run / "plan.npz")
    performed = _execution(page)
    refused = "".join(f"<li>{html.escape(reason)}" for reason in plan.refusals[:12])
    return ["<h2>Plan and checks</h2>", f"<p>{html.escape(plan.sentence)}</p>", f"<ul>{refused}</ul>" if refused else "",
            page.picture("checks", figures.checks(plan, performed), "Clearance to the world and to itself; errors of the hand.")]  # fmt: skip


def _performed(page: _Page, metrics: dict) -> list[str]:
    video = page.run / "execution.mp4"
    if "execute" not in metrics or not video.exists():
        return []
    performed = _execution(page)
    strip = figures.filmstrip(_strip(page, len(performed.strip)), performed.strip / performed.fps)
    return ["<h2>The robot performs it</h2>", f"<p>{html.escape(performed.sentence)}</p>", _conditions(performed),
            page.video(video, "Simulated in PyBullet under motor control."),
            page.picture("filmstrip", strip, "The same in six pictures.")]  # fmt: skip


def _conditions(performed) -> str:
    """The world's conditions, and what was measured."""
    rows = "".join(f"<tr><td>{html.escape(name)}<td class=number>{value:.4g}<td class=number>{bound:.4g}<td>{'met' if met else 'not met'}<td>{html.escape(said)}"
                   for name, value, bound, met, said in zip(performed.conditions, performed.measured, performed.bounds, performed.met, performed.said))  # fmt: skip
    return f"<table><tr><th>condition<th>measured<th>bound<th><th>{rows}</table>"


def _strip(page: _Page, count: int) -> list[np.ndarray]:
    """The pictures of the filmstrip, each (H, W, 3)."""
    return np.array_split(load_image(page.run / "filmstrip.png"), count, axis=1)


def _execution(page: _Page):
    from robot.execution import Execution

    path = page.run / "execution.npz"
    return Execution.load(path) if path.exists() else None


def _performed_path(page: _Page):
    performed = _execution(page)
    return None if performed is None else performed.tip


def _last_frame(page: _Page):
    """The end of the film (H, W, 3); None where nothing was performed."""
    return _strip(page, len(_execution(page).strip))[-1] if (page.run / "filmstrip.png").exists() else None


def _start(page: _Page):
    """Where the hand was when the plan was made (3,) [m]; None without a plan."""
    from robot.planner import Plan

    path = page.run / "plan.npz"
    return Plan.load(path).tip[0] if path.exists() else None


def _table(metrics: dict) -> str:
    rows = [f"<tr><td>{key}<td class=number>{f'{value:.4g}' if isinstance(value, float) else value}" for key, value in _flat(metrics)]
    return f"<details><summary>metrics.json</summary><table>{''.join(rows)}</table></details>"


def _flat(metrics: dict, prefix="") -> list[tuple[str, object]]:
    """(dotted key, value) of every number in nested groups."""
    parts = [_flat(v, f"{prefix}{key}.") if isinstance(v, dict) else [(f"{prefix}{key}", v)] for key, v in metrics.items()]
    return [pair for part in parts for pair in part]


def _embed(path: Path, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"
