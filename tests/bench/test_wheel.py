"""The wheel contains the three packages with their data files, and nothing else."""

import shutil
import subprocess
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("neoworld_mjx", "kernels/neoworld_kernels", "benchmarks/neoworld_bench")


def tracked_files():
    """Files of the packages in git, by their path in the wheel."""
    listed = subprocess.run(
        ["git", "ls-files", *PACKAGES], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    files = [path for path in listed if (ROOT / path).is_file()]
    return {path.removeprefix("kernels/").removeprefix("benchmarks/") for path in files}


@pytest.mark.slow
def test_wheel_contains_the_three_packages_with_data_files(tmp_path):
    if shutil.which("uv") is None or not (ROOT / ".git").exists():
        pytest.skip("needs uv and a clone")
    command = ["uv", "build", "--wheel", "-q", "-o", str(tmp_path), str(ROOT)]
    built = subprocess.run(command, capture_output=True, text=True)
    if built.returncode:
        pytest.skip(f"uv cannot build here: {built.stderr.strip()[-200:]}")
    (wheel,) = tmp_path.glob("*.whl")
    names = {n for n in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in n}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    included = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert tracked_files() | set(included.values()) <= names
    assert {name.split("/")[0] for name in names} == {path.split("/")[-1] for path in PACKAGES}
    assert {Path(name).suffix for name in names} >= {".py", ".yaml", ".md", ".json"}
