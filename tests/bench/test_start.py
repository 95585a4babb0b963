"""Every benchmark can be started."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_every_module_of_the_benchmarks_can_be_imported():
    modules = [path.stem for path in sorted((ROOT / "lab" / "bench").glob("*.py")) if path.stem != "__init__"]
    code = "\n".join(f"import lab.bench.{module}" for module in modules)
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        check=False,
        text=True,
    )
    assert len(modules) > 30 and done.returncode == 0, done.stderr
