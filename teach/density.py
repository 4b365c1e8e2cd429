"""Time-varying densities p(x, y | t) over a view, from the strokes drawn on it (Zhi et al. 2023, Section IV-A).

Notation
    y = (x, y)        picture coordinates in [0, 1]: pixels over the picture's width and height
    t                 normalised time in [0, 1]; p(t) is uniform
    u = (y - c(t)) / s    inputs of the conditional flow: deviation from the mean stroke c(t) over its RMS s
    z = g(u; t)       the flow; z ~ N(0, I), and log p(y | t) = log N(g(u; t)) + log |det dg/du| - log |det s|  eq. (1)
                      drawn as y = g^-1(z; t)                                                                   eq. (2)
    L = -sum_y {log N(g(y)) + log |det dg/dy|}    minimised in training                                         eq. (3)

Both flows are trained on strokes with Gaussian noise added afresh at every step, or the density would collapse onto the
few strokes there are. Trained to its end such a flow is the kernel density estimate whose bandwidth is the noise, so
the noise that predicts a stroke left out best is known in advance: that is what ``noise=None`` takes.
"""

from dataclasses import dataclass

import numpy as np
import torch
import zuko

NOISES = np.geomspace(0.001, 0.1, 25)
"""Candidates of the noise [1, fraction of the picture's size]."""


@dataclass(frozen=True, eq=False)
class ConditionalDensity:
    """p(x, y | t) [1/px^2] of a view by a flow over (x, y) given t. size: (2,) of the picture [px]."""

    flow: zuko.flows.Flow
    times: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    size: np.ndarray
    noise: float

    def log_prob(self, t, points) -> np.ndarray:
        """log p [log 1/px^2] at points (..., 2) [px] and times t that broadcast against (...,)."""
        points = np.asarray(points, dtype=float)
        t = np.broadcast_to(np.asarray(t, dtype=float), points.shape[:-1])
        u = (points / self.size - _interpolate(t, self.times, self.centre)) / self.scale
        with torch.no_grad():
            context = _context(torch.tensor(t.ravel(), dtype=torch.float32))
            log_prob = self.flow(context).log_prob(torch.as_tensor(u.reshape(-1, 2), dtype=torch.float32))
        return log_prob.numpy().astype(float).reshape(t.shape) - np.log(self.scale * self.size).sum()

    def sample(self, n: int, t, rng: np.random.Generator) -> np.ndarray:
        """n draws at each time t (T,): (T, n, 2) [px]."""
        t = np.atleast_1d(np.asarray(t, dtype=float))
        z = torch.as_tensor(rng.standard_normal((n, len(t), 2)), dtype=torch.float32)
        with torch.no_grad():
            u = self.flow(_context(torch.as_tensor(t, dtype=torch.float32))).transform.inv(z).numpy()
        return ((u * self.scale + _interpolate(t, self.times, self.centre)) * self.size).swapaxes(0, 1)


@dataclass(frozen=True)
class Flow:
    """A conditional normalizing flow p(x, y | t) per view; ``fit`` trains it.

    hidden: width of its two hidden layers. transforms: autoregressive affine transforms in a row. steps: most training
    steps. noise: standard deviation of the injected noise [fraction of the picture's size]; None chooses it by the
    likelihood of a stroke left out. learning_rate: of Adam. patience: training ends when the held-out likelihood has
    not risen for so many steps. points: along each stroke, at equal steps of time. batch: points a training step sees.
    """

    hidden: int = 48
    transforms: int = 3
    steps: int = 400
    noise: float | None = None
    learning_rate: float = 5e-3
    patience: int = 60
    points: int = 100
    batch: int = 512

    def fit(self, strokes, size, *, seed: int = 0) -> ConditionalDensity:
        """strokes: (S, N, 2) [px] at N times evenly in [0, 1]. size: width and height of the picture [px]."""
        size = np.asarray(size, dtype=float)
        y = _resample(np.asarray(strokes, dtype=float) / size, self.points)
        t = np.linspace(0, 1, self.points)
        noise = left_out_noise(y) if self.noise is None else self.noise
        centre = y.mean(axis=0)
        scale = np.sqrt(((y - centre) ** 2).mean(axis=(0, 1)) + noise**2)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            flow = zuko.flows.MAF(2, CONTEXT, transforms=self.transforms, hidden_features=[self.hidden] * 2)
            with torch.no_grad():  # start from the Gaussian tube: last layers of nearly zero make the identity
                for name, parameter in flow.named_parameters():
                    if name.split(".")[-2] == "4":  # linear, ReLU, linear, ReLU, linear
                        parameter.mul_(0.01)
            u = torch.as_tensor((y - centre) / scale, dtype=torch.float32).reshape(-1, 2)
            context = _context(torch.as_tensor(np.tile(t, len(y)), dtype=torch.float32))
            spread = torch.as_tensor(noise / scale, dtype=torch.float32)
            _train(flow, lambda batch, noise: flow(context[batch]).log_prob(u[batch] + spread * noise), u.shape, self)
        return ConditionalDensity(flow, t, centre, scale, size, float(noise))


@dataclass(frozen=True, eq=False)
class JointDensity:
    """p(x, y | t) [1/px^2] of a view by a flow over (t, x, y), which the paper divides by a uniform p(t)."""

    flow: zuko.flows.Flow
    shift: torch.Tensor
    scale: torch.Tensor
    size: np.ndarray
    noise: float

    def log_prob(self, t, points) -> np.ndarray:
        """log p(t, x, y) - log p(t) [log 1/px^2] at points (..., 2) [px] and times t that broadcast against (...,)."""
        points = np.asarray(points, dtype=float)
        t = np.broadcast_to(np.asarray(t, dtype=float), points.shape[:-1])
        y = np.concatenate([t[..., None], points / self.size], axis=-1).reshape(-1, 3)
        y = torch.as_tensor(y, dtype=torch.float32)
        with torch.no_grad():
            log_prob = torch.cat([self.flow().log_prob((part - self.shift) / self.scale) for part in y.split(20_000)])
        return log_prob.numpy().astype(float).reshape(t.shape) - float(self.scale.log().sum()) - np.log(self.size).sum()

    def sample(self, n: int, t, rng: np.random.Generator, grid: int = 100) -> np.ndarray:
        """n draws at each time t (T,): (T, n, 2) [px], from cells of a grid over the picture."""
        axes = [(np.arange(grid) + 0.5) / grid * length for length in self.size]
        cells = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        draws = []
        for time in np.atleast_1d(np.asarray(t, dtype=float)):
            log_prob = self.log_prob(time, cells)
            weights = np.exp(log_prob - log_prob.max())
            chosen = cells[rng.choice(len(cells), size=n, p=weights / weights.sum())]
            draws.append(chosen + rng.uniform(-0.5, 0.5, chosen.shape) * self.size / grid)
        return np.stack(draws)


@dataclass(frozen=True)
class JointFlow:
    """The paper's flow over (t, x, y) jointly: affine couplings (RealNVP, Dinh et al. 2017) of standardised inputs.

    The authors' public code trains 5000 steps at a constant learning rate of 3e-4, 512 wide (schedule "constant":
    teach/density=joint_flow_authors). Half as wide, at a higher rate that goes to zero, it is as good after 1500; these
    are the defaults. A still higher likelihood does no good: a density finer than its grid escapes Algorithm 1.

    hidden: width of the one hidden layer. transforms: couplings. steps: most training steps (one sees every point).
    noise: standard deviation of the noise injected into (t, x, y) in [0, 1]. learning_rate: of Adam, its highest.
    weight_decay: of Adam. schedule: of the learning rate, "one_cycle" (Smith & Topin 2019) or "constant". patience:
    training ends when the held-out likelihood has not risen for so many steps, and the best is kept; None: all points
    are trained on and the last is kept. points: along a stroke. batch: points a training step sees.
    """

    hidden: int = 256
    transforms: int = 8
    steps: int = 1500
    noise: float = 0.001
    learning_rate: float = 2e-3
    weight_decay: float = 5e-5
    schedule: str = "one_cycle"
    patience: int | None = None
    points: int = 100
    batch: int = 10_000

    def fit(self, strokes, size, *, seed: int = 0) -> JointDensity:
        """strokes: (S, N, 2) [px] at N times evenly in [0, 1]. size: width and height of the picture [px]."""
        size = np.asarray(size, dtype=float)
        y = _resample(np.asarray(strokes, dtype=float) / size, self.points)
        t = np.broadcast_to(np.linspace(0, 1, self.points)[:, None], (*y.shape[:2], 1))
        y = torch.as_tensor(np.concatenate([t, y], axis=-1).reshape(-1, 3), dtype=torch.float32)
        shift, scale = y.mean(0), y.std(0) + self.noise
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            flow = zuko.flows.RealNVP(3, transforms=self.transforms, hidden_features=[self.hidden])
            log_prob = lambda batch, noise: flow().log_prob((y[batch] + self.noise * noise - shift) / scale)
            _train(flow, log_prob, y.shape, self, self.schedule, self.weight_decay)
        return JointDensity(flow, shift, scale, size, self.noise)


def left_out_noise(strokes: np.ndarray) -> float:
    """The kernel bandwidth in NOISES under which strokes (S, N, 2), each left out in turn, are most likely given the
    others.

    With one stroke there is nothing to leave out: a hundredth of the picture.
    """
    if len(strokes) < 2:
        return 0.01
    squared = ((strokes[:, None] - strokes[None]) ** 2).sum(-1)
    squared[np.arange(len(strokes)), np.arange(len(strokes))] = np.inf
    likelihood = [np.logaddexp.reduce(-squared / (2 * h * h), axis=1).mean() - 2 * np.log(h) for h in NOISES]
    return float(NOISES[int(np.argmax(likelihood))])


SCHEDULES = {
    "cosine": lambda adam, rate, steps: torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps),
    "one_cycle": lambda adam, rate, steps: torch.optim.lr_scheduler.OneCycleLR(
        adam, rate, total_steps=max(steps, 2), pct_start=0.2, cycle_momentum=False
    ),
    "constant": lambda adam, rate, steps: torch.optim.lr_scheduler.ConstantLR(adam, factor=1.0),
}
"""How the learning rate goes over the training steps."""


def _train(flow, log_prob, shape, settings, schedule: str = "cosine", weight_decay: float = 0.0) -> None:
    """Maximise the mean of ``log_prob(batch, noise)`` with Adam; keep the weights of the best held-out likelihood.

    Held out is a tenth of the points, each with four draws of noise, the same at every look. With ``settings.patience``
    None nothing is held out and the last weights are kept. schedule: one of SCHEDULES.
    """
    if schedule not in SCHEDULES:
        raise ValueError(f"schedule is one of {', '.join(SCHEDULES)}, not {schedule!r}")
    count, dimension = shape
    order = torch.randperm(count)
    held = order[: max(count // 10, 1)].repeat(4)
    kept = order if settings.patience is None else order[count // 10 :]
    held_noise = torch.randn(len(held), dimension)
    adam = torch.optim.Adam(flow.parameters(), settings.learning_rate, weight_decay=weight_decay, fused=True)
    rate = SCHEDULES[schedule](adam, settings.learning_rate, settings.steps)
    best, best_step, best_state = -np.inf, 0, None
    for step in range(settings.steps):
        batch = kept if len(kept) <= settings.batch else kept[torch.randint(len(kept), (settings.batch,))]
        loss = -log_prob(batch, torch.randn(len(batch), dimension)).mean()
        adam.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(flow.parameters(), 10.0)
        adam.step()
        rate.step()
        if settings.patience is not None and step % 10 == 9 or step == settings.steps - 1:
            with torch.no_grad():
                score = float(log_prob(held, held_noise).mean())
            if score > best:
                best, best_step = score, step
                best_state = {name: value.clone() for name, value in flow.state_dict().items()}
            elif settings.patience is not None and step - best_step >= settings.patience:
                break
    if best_state is None:
        raise FloatingPointError("training the density diverged: lower the learning rate")
    flow.load_state_dict(best_state)


CONTEXT = 9


def _context(t: torch.Tensor) -> torch.Tensor:
    """Features (..., CONTEXT) of times t (...,): t and four harmonics, so that a small net follows quick changes."""
    waves = torch.pi * t[..., None] * torch.arange(1, 5)
    return torch.cat([2 * t[..., None] - 1, torch.sin(waves), torch.cos(waves)], dim=-1)


def _interpolate(t, times, values) -> np.ndarray:
    """values (T, D) given at ``times`` (T,), linear in between, at t (...,): (..., D)."""
    return np.stack([np.interp(t, times, column) for column in values.T], axis=-1)


def _resample(strokes: np.ndarray, count: int) -> np.ndarray:
    """(S, N, 2) at N even times -> (S, count, 2) at count even times."""
    t, even = np.linspace(0, 1, count), np.linspace(0, 1, strokes.shape[1])
    return np.stack([_interpolate(t, even, stroke) for stroke in strokes])


def over_picture(density, size, spacing: float = 8.0, times: int = 40) -> np.ndarray:
    """p(x, y) with the time axis collapsed, at every ``spacing`` [px] of a picture of width and height ``size``: (rows, columns)."""
    width, height = size
    x, y = np.meshgrid(np.arange(spacing / 2, width, spacing), np.arange(spacing / 2, height, spacing))
    pixels = np.stack([x, y], axis=-1).reshape(-1, 2)
    t = np.linspace(0, 1, times)[:, None]
    log_prob = density.log_prob(t, np.broadcast_to(pixels, (times, *pixels.shape)))
    return np.exp(log_prob).mean(axis=0).reshape(x.shape)


@dataclass(frozen=True, eq=False)
class KernelDensity:
    """p(x, y | t) [1/px^2] of a view as the mean of Gaussians around strokes; ``log_prob`` and ``sample`` as a flow has them.

    times: (T,). strokes: (S, T, 2) [px], the Gaussians' centres. covariance: (T, 2, 2) [px^2], of each of them. noise: of
    the picture's size.
    """

    times: np.ndarray
    strokes: np.ndarray
    covariance: np.ndarray
    noise: float

    def log_prob(self, t, points) -> np.ndarray:
        """log p [log 1/px^2] at points (..., 2) [px] and times t that broadcast against (...,)."""
        points = np.asarray(points, dtype=float)
        t = np.broadcast_to(np.asarray(t, dtype=float), points.shape[:-1])
        C = self._covariance_at(t)
        inverse, log_det = np.linalg.inv(C), np.log(np.linalg.det(C))
        off = np.stack([points - _interpolate(t, self.times, stroke) for stroke in self.strokes])
        squared = np.einsum("s...a,...ab,s...b->s...", off, inverse, off)
        return np.logaddexp.reduce(-0.5 * squared, axis=0) - np.log(len(self.strokes)) - 0.5 * log_det - np.log(2 * np.pi)

    def sample(self, n: int, t, rng: np.random.Generator) -> np.ndarray:
        """n draws at each time t (T,): (T, n, 2) [px]."""
        t = np.atleast_1d(np.asarray(t, dtype=float))
        centres = np.stack([_interpolate(t, self.times, stroke) for stroke in self.strokes], axis=1)  # (T, S, 2)
        chosen = centres[np.arange(len(t))[:, None], rng.integers(len(self.strokes), size=(len(t), n))]
        return chosen + rng.standard_normal((len(t), n, 2)) @ np.linalg.cholesky(self._covariance_at(t)).swapaxes(1, 2)

    def _covariance_at(self, t) -> np.ndarray:
        return _interpolate(t, self.times, self.covariance.reshape(len(self.times), 4)).reshape(*t.shape, 2, 2)


@dataclass(frozen=True)
class Kernels:
    """Kernel density estimate of the strokes at each time: what a flow trained to its end becomes.

    noise: the kernels' deviation [fraction of the picture's size]; None: the likeliest for a stroke left out. points:
    along each stroke.
    """

    noise: float | None = None
    points: int = 100

    def fit(self, strokes, size, *, seed: int = 0) -> KernelDensity:
        """strokes: (S, N, 2) [px] at N times evenly in [0, 1]. size: of the picture [px]. Nothing is random."""
        y, kernel, noise = _kernels(strokes, size, self.noise, self.points)
        return KernelDensity(np.linspace(0, 1, self.points), y, np.tile(kernel, (self.points, 1, 1)), noise)


@dataclass(frozen=True)
class GaussianTube:
    """One Gaussian at each time: the strokes' mean and covariance there.

    noise: added to the deviation [fraction of the picture's size]; None: the likeliest for a stroke left out. points:
    along each stroke.
    """

    noise: float | None = None
    points: int = 100

    def fit(self, strokes, size, *, seed: int = 0) -> KernelDensity:
        """strokes: (S, N, 2) [px] at N times evenly in [0, 1]. size: of the picture [px]. Nothing is random."""
        y, kernel, noise = _kernels(strokes, size, self.noise, self.points)
        off = y - y.mean(axis=0)
        covariance = np.einsum("sta,stb->tab", off, off) / len(y) + kernel
        return KernelDensity(np.linspace(0, 1, self.points), y.mean(axis=0, keepdims=True), covariance, noise)


def _kernels(strokes, size, noise: float | None, points: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Strokes (S, points, 2) [px], the covariance (2, 2) [px^2] of a kernel, and its deviation [of the picture's size]."""
    y, size = _resample(np.asarray(strokes, dtype=float), points), np.asarray(size, dtype=float)
    noise = float(left_out_noise(y / size) if noise is None else noise)
    return y, np.diag((noise * size) ** 2), noise
