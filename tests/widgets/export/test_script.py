"""A run as a script: without napari, the same arrays, bit for bit."""

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from napari.components import ViewerModel
from napari.layers._source import layer_source
from napari_builtins.io import magic_imread
from npe2 import PluginManifest
from PIL import Image

import napari_defocus
from napari_defocus import Annulus, MeasuredPSF, ThinLens
from napari_defocus.settings import MapSettings, MaskSettings, RefocusSettings, RestorationSettings
from napari_defocus.widgets.export.script import script_of
from napari_defocus.widgets.export.script_picture import text_literal
from napari_defocus.widgets.jobs.analysis import Analysis
from napari_defocus.widgets.jobs.distances import Distances
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.jobs.map_source import EstimatedSource, LayerSource
from napari_defocus.widgets.jobs.restoration import Refocusing, Restoration
from napari_defocus.widgets.layers.image_layers import plane_at
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY
from napari_defocus.widgets.layers.samples import dandelion, simulated_ramp
from napari_defocus.widgets.layers.seeds import Seeds

ALL = (slice(None), slice(None))
VARIABLE_OF = {
    "blur map": "blur_map",
    "confidence": "confidence",
    "in focus": "in_focus",
    "all in focus": "all_in_focus",
    "left as it was": "left_as_it_was",
    "refocused": "refocused",
    "depth": "depth",
}
TRICKY_NAME = "l'œil \"\"\" \\N{x}\nimport os\u2028\ud800#'''"

RUN = """
import contextlib, io, pickle, runpy, sys
scripts, results = sys.argv[1:]
kept = ("blur_map", "confidence", "in_focus", "depth")
kept += ("all_in_focus", "left_as_it_was", "refocused")
found = {}
for line in open(scripts, encoding="utf-8"):
    with contextlib.redirect_stderr(io.StringIO()) as said:
        variables = runpy.run_path(line.rstrip())
    found[line.rstrip()] = {name: variables[name] for name in kept if name in variables}
    found[line.rstrip()]["said"] = said.getvalue()
assert not {"napari", "qtpy", "magicgui"} & set(sys.modules)
with open(results, "wb") as file:
    pickle.dump(found, file)
"""


def run_scripts(folder, scripts):
    """Run scripts in one other process; return the results of each, and what it has said."""
    paths = {name: folder / f"{name}.py" for name in scripts}
    for name, text in scripts.items():
        paths[name].write_text(text, encoding="utf-8")
    (folder / "scripts.txt").write_text("\n".join(map(str, paths.values())))
    command = [sys.executable, "-c", RUN, folder / "scripts.txt", folder / "results"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = np.load(folder / "results", allow_pickle=True)
    return {name: found[str(path)] for name, path in paths.items()}


def picture(seed=0):
    """A small photograph: (80, 96, 3) uint8."""
    [(photograph, *_)] = dandelion()
    return photograph[60 + seed : 140 + seed, 140:236]


def opened(path, index=ALL, **keywords):
    """Open a file as napari's own reader does."""
    return added(magic_imread(str(path)), index, {"path": str(path)}, **keywords)


def added(data, index=ALL, source=None, **keywords):
    with layer_source(**(source or {})):
        layer = ViewerModel().add_image(data, **keywords)
    KEPT_ALIVE.append(layer)
    return plane_at(layer, index)


KEPT_ALIVE = []


def analysis(plane, mask=None, seeds=None, **estimation):
    mask = MaskSettings(**(mask or {}))
    return Analysis(plane=plane, estimation=MapSettings(**estimation), mask=mask, seeds=seeds)


def painted(plane):
    values = np.zeros(plane.shape, np.int32)
    values[5:15, 5:30], values[50:60, 40:80] = 1, 2
    return Seeds("seeds", values)


def enclosed(plane):
    """The part of a plane that an ellipse lies in, as one shape chooses it."""
    y, x = np.mgrid[-1:1:60j, -1:1:70j]
    return plane.part(slice(10, 70), slice(12, 82), inside=x**2 + y**2 <= 1, region="ellipse")


def all_cases(folder):
    """Return runs and the files that their pictures were saved in, if napari does not know them."""
    Image.fromarray(picture()).save(folder / "p.png")
    stack = (picture()[None, ..., 1] * np.array([1, 7, 15], np.uint16)[:, None, None]).copy()
    tifffile.imwrite(folder / "größer 'stack'.tif", stack, photometric="minisblack")
    np.save(folder / "plane.npy", stack[1] / np.float32(4000))
    kernels = [Annulus(0.5).kernel(4.0)]
    MeasuredPSF([4.0], kernels).save(folder / "lens.npz")
    sample = {"sample": ("napari-defocus", "dandelion")}
    whole = dandelion()[0][0]
    crop = (slice(60, 130), slice(150, 230))
    color = opened(folder / "p.png")
    limits = opened(folder / "größer 'stack'.tif", (2, *ALL), contrast_limits=(0, 4095))
    cut = opened(folder / "größer 'stack'.tif", (1, slice(4, None), slice(None, 90)))
    lens = {"psf": str(folder / "lens.npz"), "max_radius": 6.0}
    estimated = EstimatedSource(settings=MapSettings(max_radius=6.0))
    restoration = Restoration(
        plane=color, source=estimated, settings=RestorationSettings(), linearize="srgb"
    )
    view = RefocusSettings(focus=1.0, side="near", linearize=None)
    thin_lens = ThinLens(
        focal_length_mm=50, f_number=2, focus_distance_m=float("inf"), pixel_pitch_um=5
    )
    near = Distances(plane=color, source=estimated, lens=thin_lens, side="near", min_confidence=0.3)
    ramp = {"sample": ("napari-defocus", "ramp")}
    return {
        "color": (analysis(color), None),
        "limits": (analysis(limits, {"threshold": 1.5, "smoothness": 300.0}), None),
        "cut": (analysis(cut, shot_noise=True, linearize="srgb"), None),
        "seeds": (analysis(color, {"threshold": 0.8}, painted(color)), None),
        "shape": (analysis(enclosed(color), {"threshold": 4.0}), None),
        "lens": (analysis(color, psf="polygon:6:12.5", max_radius=6.1), None),
        "gaussian": (analysis(color, {"threshold": 1.0}, psf="gaussian", mode="paper"), None),
        "auto": (analysis(color, psf="auto"), None),
        "measured": (analysis(color, noise_variance=1e-4 / 3, smoothness=5.0, **lens), None),
        "sample": (analysis(added(whole, crop, sample), window=31, stride=6), None),
        "ramp": (analysis(added(simulated_ramp()[1][0], crop, ramp)), None),
        "plane": (analysis(added(stack / np.float32(4000), (1, *ALL))), folder / "plane.npy"),
        "tricky": (
            replace(analysis(added(picture(), name=TRICKY_NAME)), blur_map=False),
            folder / "p.png",
        ),
        "refocusing": (Refocusing(restoration=restoration, view=view), None),
        "unprotected": (
            replace(
                restoration,
                linearize=None,
                protect=False,
                show_left=True,
                settings=RestorationSettings(noise_variance=1e-4, tv_weight=0.01),
            ),
            None,
        ),
        "distances": (near, None),
    }


CASES = (
    *("shape", "color", "limits", "cut", "seeds", "lens", "gaussian", "auto", "measured"),
    *("sample", "ramp"),
    *("plane", "tricky", "refocusing", "unprotected", "distances"),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("pictures")


@pytest.fixture(scope="module")
def cases(folder):
    return all_cases(folder)


@pytest.fixture(scope="module")
def scripts(cases, folder):
    """The scripts of all cases, one for another picture, and one whose file the user has named."""
    found = {name: script_of(run, file) for name, (run, file) in cases.items()}
    Image.fromarray(picture(seed=3)).save(folder / "other.png")
    found["other"] = found["tricky"].replace("p.png", "other.png")
    nowhere = script_of(replace(analysis(added(picture())), blur_map=False))
    named = text_literal(str(folder / "p.png"))
    found["named"] = nowhere.replace('"your-picture.tif"', named)
    return found


@pytest.fixture(scope="module")
def ran(scripts, tmp_path_factory):
    return run_scripts(tmp_path_factory.mktemp("scripts"), scripts)


@pytest.mark.parametrize("name", CASES)
def test_script_gives_what_the_run_gives_bit_for_bit(cases, ran, name):
    results = cases[name][0].run(JobCache())
    layers = getattr(results, "layers", results)
    assert layers
    for data, keywords, _ in layers:
        variable = VARIABLE_OF[keywords["metadata"][METADATA_KEY]["result"]]
        values = ran[name][variable]
        assert values.dtype == data.dtype
        assert values.tobytes() == np.squeeze(data).tobytes(), variable
    assert ran[name]["said"] == "", "the picture is the same"


def test_other_picture_is_told_of_in_plain_words(ran, folder):
    told = f"{folder / 'other.png'} is another picture than was analysed in napari.\n"
    assert ran["other"]["said"] == told
    assert ran["other"]["in_focus"].shape == (80, 96)


def test_file_that_the_user_has_named_is_read(ran):
    assert ran["named"]["said"] == ""
    np.testing.assert_array_equal(ran["named"]["in_focus"], ran["tricky"]["in_focus"])


@pytest.mark.parametrize("options", [[], ["--line-length", "100"]])
def test_scripts_are_laid_out_as_ruff_likes_it(scripts, options, tmp_path):
    ruff = shutil.which("ruff", path=Path(sys.executable).parent)
    if ruff is None:
        pytest.skip("ruff is not installed")
    for name, text in scripts.items():
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    for task in (["check", "--extend-select", "E,W,I,UP,PTH,N"], ["format", "--check"]):
        command = [ruff, *task, "--isolated", *options, "."]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


def test_script_says_only_what_is_unusual(scripts):
    for unsaid in ("psf", "smoothness", "threshold", "SEEDS", "INTENSITY_RANGE", "zlib", "[:"):
        assert unsaid not in scripts["color"]
    assert not any("range" in text.lower() for text in scripts.values()), "it is found again"
    assert "threshold=1.5," in scripts["limits"]
    assert "whole[2, :, :]" in scripts["limits"]
    assert "whole[1, 4:, :90]" in scripts["cut"]


def test_seeds_that_say_nothing_are_left_out(cases):
    run, _ = cases["color"]
    empty = Seeds("seeds", np.zeros(run.plane.shape, np.uint8))
    assert script_of(replace(run, seeds=empty)) == script_of(run)


def test_edited_layer_is_not_looked_for_in_its_file(tmp_path):
    Image.fromarray(picture()).save(tmp_path / "p.png")
    plane = opened(tmp_path / "p.png")
    plane.data[3, 4] = 0
    script = script_of(analysis(plane))
    assert "p.png" not in script
    assert 'PICTURE_FILE = Path("your-picture.tif")' in script


def test_user_names_the_file_of_a_picture_from_nowhere():
    plane = added(picture(), name="leaf")
    script = script_of(analysis(plane))
    line = 'PICTURE_FILE = Path("your-picture.tif")'
    assert '# Name the file of the layer "leaf" here' in script.partition(line)[0]


def test_samples_are_known_when_they_are_opened_in_napari(npe2pm):
    npe2pm.register(
        PluginManifest.from_file(Path(napari_defocus.__file__).with_name("napari.yaml"))
    )
    viewer = ViewerModel()
    for name in ("dandelion", "brushes"):
        [layer] = viewer.open_sample("napari-defocus", name)
        script = script_of(analysis(plane_at(layer, ALL)))
        assert f'files("napari_defocus.samples") / "{name}.jpg"' in script
    layer.data = layer.data[::-1]
    assert "your-picture" in script_of(analysis(plane_at(layer, ALL)))


def test_file_that_does_not_hold_the_picture_is_refused(tmp_path):
    np.save(tmp_path / "other.npy", picture(seed=1))
    for name in ("other.npy", "none.npy"):
        with pytest.raises(ValueError, match=f"picture_file is .*{name}; it takes"):
            script_of(analysis(added(picture())), tmp_path / name)


def test_scripts_and_preferences_need_no_qt():
    modules = "napari_defocus.widgets.export.script, napari_defocus.widgets.layers.preferences"
    code = f"import sys, {modules}; print(*{{'qtpy.QtWidgets', 'PySide6'}} & set(sys.modules))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []


def test_map_of_a_layer_cannot_be_made_again(texture):
    source = LayerSource(plane=added(texture), psf="disc")
    wanted = Restoration(plane=added(texture), source=source, settings=RestorationSettings())
    with pytest.raises(ValueError, match="Have it estimated instead"):
        script_of(wanted)


@pytest.mark.parametrize(
    "text",
    [
        "leaf",
        "",
        TRICKY_NAME,
        '"',
        "'",
        "'\"",
        '"""',
        "\\",
        "C:\\new\\table",
        "a\rb\0",
        "𝄞 é ﬁ \xa0",
    ],
)
def test_any_name_is_one_line_of_python_that_means_it(text):
    line = text_literal(text)
    assert eval(line) == text
    assert len(f"x{line}x".splitlines()) == 1
    line.encode("utf-8")


def test_long_paths_are_broken_between_folders(tmp_path):
    folder = tmp_path.joinpath(*(f"a rather long name of folder {n}" for n in range(5)))
    folder.mkdir(parents=True)
    Image.fromarray(picture()).save(folder / "p.png")
    script = script_of(analysis(opened(folder / "p.png")))
    assert max(map(len, script.splitlines())) <= 88
    lines = script[script.index("PICTURE_FILE =") : script.index("FINGERPRINT =")]
    variables = {"Path": Path}
    exec(lines, variables)
    assert variables["PICTURE_FILE"] == folder / "p.png"
