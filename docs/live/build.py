"""Builds index.html, the page of the site that runs exported filters in the browser.

    pip install . ziglang
    python docs/live/build.py

It needs npm, which loads esbuild, three.js and uPlot. Everything is put into the one file, which
opens without a network. The file is committed: the site copies it, and a test says when it is
older than what it is built from.
"""

import hashlib
import json
import shutil
import subprocess
import sys
from html import escape
from pathlib import Path

import posegsa

HERE = Path(__file__).parent
BUILD = HERE / "build"  # ignored by git
PAGE = HERE / "index.html"
FILTERS = ("recommended", "kalman", "observer", "disturbed")  # configurations
SOURCES = ("*.c", "*.js", "*.css", "page.html", "package.json", "build.py")


def digest() -> str:
    """Of the sources and the configurations. It does not depend on the compiler or the CPU."""
    files = [path for pattern in SOURCES for path in HERE.glob(pattern)]
    files += [HERE.parents[1] / "configs" / f"{name}.toml" for name in FILTERS]
    of_all = hashlib.sha256()
    for path in sorted(files, key=lambda path: path.name):
        of_all.update(f"{path.name}\n{path.read_text(encoding='utf-8')}\n".encode())
    return of_all.hexdigest()


def defines(experiment: posegsa.Experiment) -> list[str]:
    """Compiler definitions for filter.c: what the filter schedules."""
    chosen = experiment.filter
    if chosen.kind == "observer":
        return ["-DGAIN"]
    return ["-DUNKNOWN"] * (chosen.unknown != "off") + ["-DBELIEF"] * (chosen.belief != "off")


def write_headers(folder: Path) -> dict[str, posegsa.Experiment]:
    """Exports each filter as FOLDER/NAME/posegsa.h, and returns the experiments by name."""
    experiments = {}
    for name in FILTERS:
        result = posegsa.configured(name)
        header = folder / name / "posegsa.h"
        header.parent.mkdir(parents=True, exist_ok=True)
        header.write_text(posegsa.export_c(result), encoding="utf-8")
        experiments[name] = result.experiment
    return experiments


def world(experiments: dict[str, posegsa.Experiment]) -> dict:
    """The sensors of the configurations, as the page simulates them."""

    def references(of, place: str) -> list[dict]:
        return [{"at": getattr(each, place), "bias": each.bias, "noise": each.noise} for each in of]

    first, disturbed = experiments[FILTERS[0]].scenario, experiments["disturbed"]
    vectors = references(first.vectors, "direction")
    for name, experiment in experiments.items():
        here = experiment.scenario
        assert references(here.vectors, "direction") == vectors, f"{name}: other vectors"
        assert here.sampling_time == first.sampling_time, f"{name}: another rate"
    bursts, landmark_bursts = disturbed.family.bursts, disturbed.family.landmark_bursts
    return {
        "dt": first.sampling_time,
        "angularVelocity": {
            "bias": first.angular_velocity_bias,
            "noise": first.angular_velocity_noise,
        },
        "velocity": {"bias": first.velocity_bias, "noise": first.velocity_noise},
        "vectors": vectors,
        "bursts": {  # the middle of what the configuration draws
            "duration": sum(bursts.duration) / 2,
            "vector": sum(bursts.size) / 2,
            "landmark": sum(landmark_bursts.size) / 2,
        },
        "filters": {
            name: {
                "landmarks": references(each.scenario.landmarks, "position"),
                "landmarkPeriod": each.scenario.landmark_period,
                "scheduled": "".join(defines(each))[2:].lower(),
            }
            for name, each in experiments.items()
        },
    }


def run(*command: str | Path) -> None:
    """Runs a program in the folder of what is built."""
    subprocess.run([str(each) for each in command], cwd=BUILD, check=True)


def compile_filters(experiments: dict[str, posegsa.Experiment]) -> None:
    """Each header as BUILD/NAME/filter.wasm."""
    zig = [sys.executable, "-m", "ziglang", "cc", "--target=wasm32-wasi", "-mexec-model=reactor"]
    for name, experiment in experiments.items():
        options = ["-std=c99", "-O2", "-Wl,--strip-all", "-I", name, *defines(experiment)]
        run(*zig, *options, HERE / "filter.c", "-o", f"{name}/filter.wasm")


def bundle() -> tuple[str, str]:
    """The page's script and style, with what they import."""
    shutil.copy(HERE / "package.json", BUILD)
    run("npm", "install", "--no-package-lock", "--no-audit", "--no-fund", "--loglevel=error")
    binaries = ", ".join(f"{name}: {name}_" for name in FILTERS)
    imports = "\n".join(f'import {name}_ from "./{name}/filter.wasm";' for name in FILTERS)
    built = f"{imports}\nexport const binaries = {{ {binaries} }};\n"
    built += 'export { default as world } from "./world.json";\n'
    (BUILD / "built.js").write_text(built, encoding="utf-8")
    for source in (*HERE.glob("*.js"), *HERE.glob("*.css")):  # beside node_modules
        shutil.copy(source, BUILD)
    run(
        *("node_modules/.bin/esbuild", "page.js", "--bundle", "--minify", "--format=iife"),
        *("--loader:.wasm=binary", "--target=es2022", "--charset=utf8", "--legal-comments=none"),
        *("--log-level=warning", "--outfile=bundle.js"),
    )
    texts = [(BUILD / f"bundle.{kind}").read_text(encoding="utf-8") for kind in ("js", "css")]
    return texts[0].strip(), texts[1].strip()


def licences() -> str:
    """The notices of what is in the file."""
    import ziglang  # only the build needs it

    libc = Path(ziglang.__file__).parent / "lib" / "libc" / "musl" / "COPYRIGHT"
    notices = {
        "three.js": BUILD / "node_modules/three/LICENSE",
        "uPlot": BUILD / "node_modules/uplot/LICENSE",
        "posegsa": HERE.parents[1] / "LICENSE",
        "The functions of the mathematics library: musl": libc,
    }
    texts = (f"{name}\n\n{path.read_text(encoding='utf-8')}" for name, path in notices.items())
    return "\n\n".join(texts).replace("--", "- -")  # two hyphens may not stand in a comment


def main() -> None:
    """Builds the page."""
    experiments = write_headers(BUILD)
    text = json.dumps(world(experiments))
    (BUILD / "world.json").write_text(text, encoding="utf-8")
    compile_filters(experiments)
    script, style = bundle()
    page = (HERE / "page.html").read_text(encoding="utf-8")
    parts = {"DIGEST": escape(digest()), "LICENCES": licences(), "STYLE": style, "SCRIPT": script}
    for name, part in parts.items():
        assert page.count(f"@{name}@") == 1, f"page.html: @{name}@ has to be there once"
        page = page.replace(f"@{name}@", part)
    PAGE.write_text(page, encoding="utf-8")
    print(f"{PAGE}: {PAGE.stat().st_size} bytes")


if __name__ == "__main__":
    main()
