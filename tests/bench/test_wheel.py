"""The wheel contains the packages with their data files and nothing else; the sdist is small."""

import shutil
import subprocess
import tarfile
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


MOST_MIB = 3.0
"""Size of either file [MiB]."""


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder of the sdist, and of the wheel that was built from it."""
    if shutil.which("uv") is None or not (ROOT / ".git").exists():
        pytest.skip("needs uv and a clone")
    folder = tmp_path_factory.mktemp("dist")
    command = ["uv", "build", "-q", "-o", str(folder), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"uv cannot build here: {done.stderr.strip()[-200:]}")
    return folder


@pytest.mark.slow
def test_wheel_contains_the_three_packages_with_data_files(built):
    (wheel,) = built.glob("*.whl")
    contained = zipfile.ZipFile(wheel).namelist()
    names = {n for n in contained if ".dist-info/" not in n}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    included = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert tracked_files() | set(included.values()) <= names
    assert {name.split("/")[0] for name in names} == {path.split("/")[-1] for path in PACKAGES}
    assert {Path(name).suffix for name in names} >= {".py", ".yaml", ".md", ".json"}
    licences = {name.split("/licenses/")[1] for name in contained if "/licenses/" in name}
    assert licences == {"LICENSE", "NOTICE"}
    assert wheel.stat().st_size < MOST_MIB * 2**20


@pytest.mark.slow
def test_sdist_is_small_and_contains_code_tests_and_credits(built):
    (sdist,) = built.glob("*.tar.gz")
    assert sdist.stat().st_size < MOST_MIB * 2**20
    with tarfile.open(sdist) as packed:
        names = {name.split("/", 1)[1] for name in packed.getnames() if "/" in name}
    assert names >= {"LICENSE", "NOTICE", "README.md", "examples/coffee.png", "tests/conftest.py"}
    folders = {name.split("/")[0] for name in names}
    assert not folders & {"docs", "notebooks", ".github", ".ci", "dist"}
