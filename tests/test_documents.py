"""What the README and the documents say is so: their scripts run, the names they list are there."""

import re
import runpy
import shutil
from pathlib import Path

import numpy as np
import pytest

import pincontact as pc

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "pincontact" / "docs"
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("*.md"))]


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
    assert any(isinstance(value, pc.Contour) for value in names.values()) or "Catenary" in names


def test_public_names_are_listed():
    section = re.search(r"## The public names(.*?)\n## ", DOCUMENTS[0].read_text(encoding="utf-8"), re.DOTALL)
    missing = [name for name in pc.__all__ if f"`{name}`" not in section[1]]
    assert not missing


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


FOLDERS = [ROOT / "pincontact", ROOT, ROOT / "tests", ROOT / "tests" / "stress", *(ROOT / "examples").glob("**/")]


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
