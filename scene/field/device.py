"""Where a field's voxels lie: in numpy's arrays for the kernels, or in tensors on one of torch's devices."""

import numpy as np
import torch

DEVICES = "'auto', 'cpu', 'cuda', 'cuda:1' and so on, 'torch'"


def chosen(name: str) -> torch.device | None:
    """The torch device of a setting; None for the kernels.

    "cpu": the kernels. "cuda": torch on a GPU. "auto": on a GPU where there is one, else the kernels. "torch": torch on the
    CPU, slow, to see that it does what the kernels do. ValueError if the device is not there.
    """
    gpu = torch.cuda.is_available()
    if name == "cpu" or (name == "auto" and not gpu):
        return None
    if name == "torch":
        return torch.device("cpu")
    if name not in ("auto", "cuda") and not (name.startswith("cuda:") and name[5:].isdecimal()):
        raise ValueError(f"there is no device {name!r}; use one of {DEVICES}")
    if not gpu:
        raise ValueError(f"device {name!r} needs a GPU, and torch {torch.__version__} finds none; use 'cpu' or 'auto'")
    device = torch.device("cuda", int(name[5:] or 0))
    if device.index >= torch.cuda.device_count():
        raise ValueError(f"there is no device {name!r}, only {torch.cuda.device_count()} GPU; use 'cuda'")
    return device


def placed(numbers, device: torch.device | None):
    """An array or a tensor as a tensor on ``device``, or as an array for None; it shares memory where it can."""
    if device is None:
        return numbers.cpu().numpy() if isinstance(numbers, torch.Tensor) else numbers
    return torch.as_tensor(numbers, device=device)


def lengthened(rows, count: int):
    """``rows`` followed by zero rows, ``count`` in all; the system gives these memory only when they are first touched."""
    shape = (count, *rows.shape[1:])
    longer = rows.new_zeros(shape) if isinstance(rows, torch.Tensor) else np.zeros(shape, rows.dtype)
    longer[: len(rows)] = rows
    return longer
