"""The house: scene <- teach <- robot, conf ties them together; each heavy library has one room."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("scene", "teach", "robot", "conf")
FILES = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
COMMANDS = ("robot.capture", "scene.reconstruct", "scene.train", "scene.mesh", "scene.render", "scene.tags", "teach.draw", "teach.fit", "robot.plan", "robot.execute")  # fmt: skip
MAY_IMPORT = {
    "scene": {"scene"},
    "teach": {"teach", "scene.camera", "scene.files"},
    "robot": {"robot", "teach.trajectory", "teach.sketch", "teach.hull", "scene.camera", "scene.files"},
    "conf": {"conf", "scene", "teach", "robot"},
}
ONLY_IN = {"pycolmap": ("scene/colmap/",), "open3d": ("scene/surface/",), "pybullet": ("robot/bullet.py",), "pybullet_utils": ("robot/bullet.py",),
           "pybullet_data": ("robot/",), "hydra": ("conf/",), "omegaconf": ("conf/",)}  # fmt: skip


def module(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def imports(path: Path, top_level_only=False) -> set[str]:
    """Dotted names a file imports; ``from a import b`` counts as a and as a.b."""
    found = set()
    tree = ast.parse(path.read_text())
    nodes = tree.body if top_level_only else list(ast.walk(tree))
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize("path", FILES, ids=module)
def test_rooms_import_in_one_direction(path):
    if module(path) in COMMANDS:
        return
    allowed = MAY_IMPORT[path.relative_to(ROOT).parts[0]]
    for name in imports(path):
        if name.split(".")[0] in ROOMS and name not in ROOMS:
            assert any(name == a or name.startswith(a + ".") for a in allowed), f"{module(path)} imports {name}"


@pytest.mark.parametrize("path", FILES, ids=module)
def test_nothing_imports_a_command(path):
    assert not imports(path) & set(COMMANDS)


@pytest.mark.parametrize("path", FILES, ids=module)
def test_each_heavy_library_has_one_room(path):
    relative = path.relative_to(ROOT).as_posix()
    for name in {name.split(".")[0] for name in imports(path)} & set(ONLY_IN):
        assert relative.startswith(ONLY_IN[name]), f"{relative} imports {name}"


@pytest.mark.parametrize("path", sorted((ROOT / "tests" / "benchmarks").glob("*.py")), ids=module)
def test_benchmarks_import_what_there_is(path):
    """They are run seldom; a name that moved would be found out late."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in ROOMS:
            file = ROOT / node.module.replace(".", "/")
            source = file.with_suffix(".py") if file.with_suffix(".py").is_file() else file / "__init__.py"
            for name in (alias.name for alias in node.names):
                there = re.search(rf"(?m)^(?=\S).*\b{name}\b|^ *import {name}\b", source.read_text())
                assert there or (file / f"{name}.py").is_file() or (file / name).is_dir(), f"{path.name} imports {node.module}.{name}"


def test_the_only_packages_are_the_four_rooms():
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert packages == set(ROOMS)


@pytest.mark.parametrize("light", ["scene.camera", "teach.sketch", "teach.trajectory", "conf.pipeline"])
def test_light_modules_do_not_load_heavy_ones(light):
    heavy = ("torch", "pycolmap", "pybullet", "numba", "matplotlib", "cv2", "scipy")
    code = f"import sys, {light}; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT).stdout.strip() == "[]"
