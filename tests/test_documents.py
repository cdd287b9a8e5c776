"""What the README and the documents say is so: their scripts run, the names they list are there."""

import inspect
import re
import runpy
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from shared import kinds_of

import pincontact as pc

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "pincontact" / "docs"
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("**/*.md"))]
NOTEBOOKS = [path for path in sorted((DOCS / "tutorials").glob("*.md")) if path.stem != "index"]


def scripts(name):
    """The Python blocks of a document."""
    return re.findall(r"```python\n(.*?)```", (ROOT / name).read_text(encoding="utf-8"), re.DOTALL)


def result_of(script, folder, monkeypatch):
    """Global names after a script was run as a file in a folder with the package's URDFs."""
    shutil.copytree(ROOT / "urdf", folder / "urdf")
    monkeypatch.chdir(folder)
    (folder / "script.py").write_text(script, encoding="utf-8")
    return runpy.run_path("script.py", run_name="__main__")


@pytest.mark.parametrize("index", range(len(scripts("README.md"))))
def test_scripts_of_the_readme(index, tmp_path, monkeypatch):
    names = result_of(scripts("README.md")[index], tmp_path, monkeypatch)
    if "run" in names:
        assert names["run"].status == 0, names["run"].message
        assert max(values.max() for values in names["run"].residuals().values()) <= 1e-12
    if "table" in names:
        # a solid ball's slip ends after 2 v / (7 mu g), to the tolerance of the run
        expected = 2.0 / (7.0 * names["table"].column("mu") * 9.81)
        np.testing.assert_allclose(names["table"].column("rolls_after"), expected, rtol=1e-7)


@pytest.mark.parametrize("index", range(len(scripts("pincontact/docs/contours.md"))))
def test_scripts_about_contours(index, tmp_path, monkeypatch):
    names = result_of(scripts("pincontact/docs/contours.md")[index], tmp_path, monkeypatch)
    assert any(isinstance(value, (pc.Contour, pc.Motion)) for value in names.values()) or "Catenary" in names
    if "belt" in names:
        # sliding friction alone drives the block until it is as fast as the belt
        times = [event.time for event in names["run"].events]
        np.testing.assert_allclose(times, 4 * [1.0 / (0.1 * 9.81)], rtol=1e-7)


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks(notebook, tmp_path, monkeypatch):
    """The cells of a tutorial as one script: the site shows what they print, here their results are looked at."""
    pyplot = pytest.importorskip("matplotlib.pyplot", reason="Matplotlib is not installed: notebooks draw with it")
    monkeypatch.setattr(pyplot, "show", lambda: None)
    monkeypatch.delenv("PINCONTACT_SITE_FILES", raising=False)
    cells = re.findall(r"```\{code-cell\}\n(?::[^\n]*\n)*(.*?)```", notebook.read_text(encoding="utf-8"), re.DOTALL)
    names = result_of("\n".join(cells), tmp_path, monkeypatch)
    pyplot.close("all")
    if "run" in names:
        assert names["run"].status in (0, 1), names["run"].message
        assert max(values.max() for values in names["run"].residuals().values()) <= 1e-12
    # what the text says of the results
    if notebook.stem == "first_run":
        assert [event.kind for event in names["run"].events] == ["stick", "slip", "stick"]
    elif notebook.stem == "own_robot":
        assert not names["run"].events and (names["run"].contacts["tip/table"].mode == 1).all()
    elif notebook.stem == "friction_and_events":
        kinds = [event.kind for event in names["run"].events]
        assert kinds == ["stick", "slip"] * (len(kinds) // 2) + ["stick"] * (len(kinds) % 2) and len(kinds) > 4
        # events are located to the tolerances of the run
        slips = [names["stiffness"] * event.q[0] for event in names["run"].events if event.kind == "slip"]
        np.testing.assert_allclose(slips, names["law"].mu_static * 9.81, rtol=1e-8)
    elif notebook.stem == "control_loop":
        assert np.linalg.norm(names["history"][-1, 1:3]) < 1e-3 and names["away"].max() < 2e-3
    elif notebook.stem == "bicycle":
        assert names["weave"] == pytest.approx(4.29238253634111, abs=1e-9)
        assert names["capsize"] == pytest.approx(6.02426201538837, abs=1e-9)
    else:
        np.testing.assert_allclose(names["table"].column("time"), names["expected"], rtol=1e-8)


def test_drawings(monkeypatch):
    """Each drawing's bodies touch, and its frames are dual, to rounding; what is drawn is there."""
    pytest.importorskip("matplotlib", reason="Matplotlib is not installed: nothing is drawn")
    monkeypatch.syspath_prepend(str(DOCS))
    monkeypatch.setenv("MPLBACKEND", "Agg")
    import drawings

    assert sorted(drawings.CASES) == sorted(["P-2C", "P-3C", "P-S", "2C-2C", "3C-3C", "3C-S", "S-S"])
    for name in drawings.CASES:
        contact = drawings.touch(name).contact
        np.testing.assert_allclose(contact.f, 0.0, atol=1e-13)
        np.testing.assert_allclose(contact.dual_frame.T @ contact.frame, np.eye(3), atol=1e-13)
    oblique = drawings.touch("3C-3C").contact.frame
    assert abs(oblique[:, 0] @ oblique[:, 1]) > 0.3
    figure = drawings.patterns()
    assert [ax.get_title() for ax in figure.axes] == list(drawings.CASES)
    drawings.plt.close("all")


@cache
def attributes(kind):
    """Of a class and of its objects."""
    assigned = re.findall(r"self\.(\w+)", inspect.getsource(kind))
    return {*dir(kind), *getattr(kind, "__annotations__", ()), *assigned}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_documents_use_names_that_are_there(document):
    text = document.read_text(encoding="utf-8")
    # a class of its own
    assert not [name for name in set(re.findall(r"\bpc\.(\w+)", text)) - {"Catenary"} if not hasattr(pc, name)]
    kinds = {"scene": pc.Scene, "run": pc.Trajectory, "track": pc.ContactTrack, "stepper": pc.Stepper}
    # names of files have a dot, too
    uses = set(re.findall(r"\b(scene|run|track|stepper)\.(?!html|npz|rrd|toml|py\b)([a-z]\w*)", text))
    assert not [f"{owner}.{name}" for owner, name in uses if name not in attributes(kinds[owner])]


def keywords():
    """Names of the arguments of all public functions and methods."""
    from pincontact import gym

    found = {"type"}  # an attribute of MuJoCo's files
    for thing in [*(getattr(pc, name) for name in pc.__all__), gym.ContactEnv]:
        methods = [method for name, method in vars(thing).items() if name[0] != "_"] if isinstance(thing, type) else []
        for call in filter(callable, [thing, *(getattr(method, "__func__", method) for method in methods)]):
            found |= set(inspect.signature(call).parameters)
    return found


@pytest.mark.parametrize("document", [DOCUMENTS[0], *DOCUMENTS[2:]], ids=lambda path: path.name)
def test_documents_use_arguments_that_are_there(document):
    """What stands before a `=` in inline code, as `redundant=` or `method="Moreau"`, but in elements of a file."""
    pytest.importorskip("gymnasium", reason="needs gymnasium: pip install pincontact[gym]")
    text = re.sub(r"```.*?```", "", document.read_text(encoding="utf-8"), flags=re.DOTALL)
    named = {
        name for code in re.findall(r"`([^<`\n][^`\n]*)`", text) for name in re.findall(r"(?:^|[(, ])(\w+)=(?!=)", code)
    }
    assert named <= keywords()


def test_scene_files_are_described(tmp_path):
    """The tables of keys are those of the messages about unknown ones; the file that is shown runs."""
    text = (DOCS / "scene_files.md").read_text(encoding="utf-8")
    path = tmp_path / "scene.toml"
    shutil.copytree(ROOT / "urdf", tmp_path / "urdf")
    path.write_text(re.search(r"```toml\n(.*?)```", text, re.DOTALL)[1], encoding="utf-8")
    run = pc.load_scene(path).simulate()
    assert run.success and run.t.size == 101

    def known(table):
        path.write_text(f'urdf = "urdf/ball.urdf"\n{table}\nodd = 1\n', encoding="utf-8")
        with pytest.raises(pc.SceneFileError, match="odd: unknown key") as told:
            pc.load_scene(path)
        return set(re.findall(r"\w+", str(told.value).split("expected one of ")[1]))

    tables = re.findall(r"^\| `\[([\w.]+)\]` \| (.*) \|$", text, re.MULTILINE)
    keys = {table: set(re.findall(r"`(\w+)`", cell)) for table, cell in tables}
    for table in ("collision", "contacts.NAME", "initial", "simulation"):
        between = 'between = ["a", "b"]' * table.startswith("contacts")
        assert known(f"[{table}]\n{between}") == keys[table], table
    assert known("") == {
        *re.findall(r"`(\w+)`", re.search(r"^\| at the top \| (.*)$", text, re.MULTILINE)[1]),
        *("constants", "collision", "contours", "contacts", "initial", "simulation"),
    }
    described = set()
    for names, cell in re.findall(r"^\| (`[A-Z].*?) \| (.*?)\s*\|$", text, re.MULTILINE):
        for kind in re.findall(r"\w+", names):
            own = set(re.findall(r"`(\w+)`", cell))
            described.add(kind)
            if issubclass(getattr(pc, kind), pc.Motion):
                assert known(f"[contours.c]\nkind = 'Point'\n[contours.c.motion]\nkind = '{kind}'") == own | {"kind"}
                continue
            found = known(f"[contours.c]\nkind = '{kind}'")
            if kind == "HeightField":
                found |= known("[contours.c]\nkind = 'HeightField'\nz = []")
            assert found == own | keys["contours.NAME"], kind
    kinds = kinds_of(pc.Contour) | kinds_of(pc.Motion)
    assert described == kinds, f"the table of scene_files.md lacks {kinds - described}, or has {described - kinds}"


def test_reference_lists_all_public_names():
    text = (DOCS / "api.md").read_text(encoding="utf-8")
    listed = re.findall(r"^   (\w+)$", text, re.MULTILINE)
    # of an extra's module
    assert "\n   gym.ContactEnv\n" in text
    missing, unknown = set(pc.__all__) - set(listed), set(listed) - set(pc.__all__)
    assert not missing and not unknown, f"api.md lacks {missing}, or has {unknown}"
    assert len(listed) == len(set(listed))


def test_the_readme_lists_public_names():
    section = re.search(r"## The public names(.*?)\n## ", DOCUMENTS[0].read_text(encoding="utf-8"), re.DOTALL)
    missing = [name for name in pc.__all__ if f"`{name}`" not in section[1]]
    assert not missing, f"the README's list of public names lacks {missing}"


def test_documents_list_every_kind():
    """Contours and friction laws, where their parameters are."""
    contours, laws, lacks = kinds_of(pc.Contour), kinds_of(pc.FrictionLaw), {}
    for file, names, form in (
        (DOCS / "conventions.md", contours, "| `{}("),
        (DOCS / "cheat_sheet.md", contours | laws, "pc.{}"),
        (DOCUMENTS[0], laws, "`pc.{}("),
        (DOCS / "scene_files.md", laws - {"Coulomb", "NoSlip"}, "`{}`"),
    ):
        text = file.read_text(encoding="utf-8")
        missing = {name for name in names if form.format(name) not in text}
        if missing:
            lacks[file.name] = missing
    assert not lacks


def test_every_kind_of_event_is_listed():
    """What the sources announce by name, in the docstring of `Event` and in the table of events."""
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "pincontact" / "integration").glob("*.py")]
    announced = {kind for text in sources for kind in re.findall(r'announce\([^"\n]*"(\w+)"', text)}
    explained = set(re.findall(r'"(\w+)"', re.search(r"kind : str(.*?)\n    q :", pc.Event.__doc__, re.DOTALL)[1]))
    table = re.search(r"\n\| `event.kind`(.*?)\n\n", (DOCS / "conventions.md").read_text(encoding="utf-8"), re.DOTALL)[
        1
    ]
    listed = {kind for row in table.splitlines()[2:] for kind in re.findall(r"`(\w+)`", row.split("|")[1])}
    assert announced and not announced - explained, f"the docstring of Event lacks {announced - explained}"
    assert listed == explained, f"conventions.md and the docstring of Event differ by {listed ^ explained}"


def test_paper_table_names_what_is_there():
    """Every module, function and test in the tables of `paper.md` and of the README's section about the paper."""
    readme = re.search(r"## The paper(.*?)\n## ", DOCUMENTS[0].read_text(encoding="utf-8"), re.DOTALL)[1]
    lines = [*(DOCS / "paper.md").read_text(encoding="utf-8").splitlines(), *readme.splitlines()]
    checked = 0
    for line in lines:
        for file, names in re.findall(r"`((?!test_)[\w/]+\.py)`(?:: ((?:`\w+`(?:, )?)+))?", line):
            path = ROOT / file if file.startswith("examples/") else ROOT / "pincontact" / file
            source = path.read_text(encoding="utf-8")
            for name in re.findall(r"\w+", names):
                assert re.search(rf"^\s*(def|class) {name}\b", source, re.MULTILINE), f"{file}: {name}"
                checked += 1
        source = ""
        for file, test in re.findall(r"`(test_\w+\.py)?(?:::(test_\w+))?`", line):
            source = (ROOT / "tests" / file).read_text(encoding="utf-8") if file else source
            if test:
                assert f"def {test}(" in source, f"{file}: {test}"
                checked += 1
    assert checked > 60


FOLDERS = [ROOT / "pincontact", ROOT, DOCS, ROOT / "tests", ROOT / "tests" / "stress", *(ROOT / "examples").glob("**/")]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_documents_name_what_is_there(document):
    """Files, and the functions and classes that are named after a file."""
    text = re.sub(r"```.*?```", "", document.read_text(encoding="utf-8"), flags=re.DOTALL)
    text = re.sub(r"\s*\n\s*", " ", text)
    for file, names in re.findall(r"`([\w/]+\.py)`(?::? ((?:`[\w.]+`(?:, | and )?)+))?", text):
        path = next((folder / file for folder in FOLDERS if (folder / file).exists()), None)
        assert path is not None, file
        source = path.read_text(encoding="utf-8")
        for name in re.findall(r"\w+", " ".join(n for n in re.findall(r"`([\w.]+)`", names) if not n.endswith(".py"))):
            assert re.search(rf"\b(def|class) {name}\b|^{name}\b.*=", source, re.MULTILINE), f"{file}: {name}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(document):
    for link in re.findall(r"\]\(([^)#]+)\)", document.read_text(encoding="utf-8")):
        assert link.startswith("https://") or (document.parent / link).exists(), link
