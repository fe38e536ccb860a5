"""The guide: `sphinx-build -W -b html engine/docs dist/docs`; it reads the code, runs nothing."""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

HERE = Path(__file__).parent
ENGINE = HERE.parent
ROOT = ENGINE.parent
EXAMPLES = ROOT / "plant_examples"
sys.path[:0] = [str(ENGINE), str(ROOT / "fmu_src")]

import vibroscreen  # noqa: E402
from vibroscreen import ScreenConfig  # noqa: E402
from vibroscreen.cli.solved import schema  # noqa: E402
from vibroscreen_fmu.port import UNITS, Port  # noqa: E402
from vibroscreen_fmu.ports import ports  # noqa: E402

project = "vibroscreen"
release = version = vibroscreen.__version__
copyright = "vibroscreen, MIT licence"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary"]
exclude_patterns = ["README.md"]
default_role = "code"
smartquotes = False

myst_enable_extensions = ["deflist", "dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_preserve_defaults = True
autosummary_generate = False

html_theme = "pydata_sphinx_theme"
html_title = "vibroscreen"
html_static_path = ["_static"]
html_css_files = ["guide.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "navbar_align": "left",
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
pygments_style = "friendly"


# --- equations: MathML, which browsers draw by themselves ---------------------------------------
def drawn(tex: str, *, as_block: bool = False) -> str:
    """MathML of TeX, with room around the names of functions."""
    room = '<mspace width="0.17em"></mspace>'
    name = re.compile(r"(<m(?:sup|sub|under)>\s*)?(<mi>(?:sin|cos|cot)</mi>)")
    found = tex2mathml(tex, as_block=as_block)
    return name.sub(lambda m: m[0] if m[1] else f"{room}{m[2]}{room}", found)


def inline_math(translator: Any, node: nodes.math) -> None:
    translator.body.append(drawn(node.astext()))
    raise nodes.SkipNode


def block_math(translator: Any, node: nodes.math_block) -> None:
    equation = drawn(node.astext(), as_block=True)
    translator.body.append(f'<div class="equation">{equation}</div>')
    raise nodes.SkipNode


# --- pages that stand elsewhere or follow from the code ----------------------------------------
def read_elsewhere(app: Sphinx, page: str, source: list[str]) -> None:
    """MODEL.md and VALIDATION.md are chapters, with links that hold here."""
    if page not in ("model", "validation"):
        return
    (file,) = ENGINE.rglob(f"{page.upper()}.md")
    app.env.note_dependency(str(file))
    text = file.read_text(encoding="utf-8")
    text = re.sub(r"\]\((?:[\w.]+/)*(MODEL|VALIDATION)\.md", lambda m: f"]({m[1].lower()}.md", text)
    text = text.replace("](docs/", "](")
    folder = "../" + file.parent.relative_to(ENGINE).as_posix()
    source[0] = re.sub(r"(!\[[^\]]*\])\((?!\.)", rf"\1({folder}/", text)


def is_future(line: ast.stmt) -> bool:
    return isinstance(line, ast.ImportFrom) and line.module == "__future__"


class Example:
    """A script: the question that its docstring asks, what it says of it, its picture."""

    def __init__(self, script: Path) -> None:
        tree = ast.parse(script.read_text(encoding="utf-8"))
        first, _, rest = (ast.get_docstring(tree) or script.stem).partition("\n\n")
        question, mark, more = " ".join(first.split()).partition("?")
        self.name = script.stem
        self.question = question + mark
        self.text = re.sub(
            r"(?m)^((?: {4}.*\n?)+)", r"```text\n\1\n```\n", f"{more.strip()}\n\n{rest}"
        )
        self.code = next(line.lineno for line in tree.body[1:] if not is_future(line))
        self.path = f"../../../{script.relative_to(ROOT).as_posix()}"
        pictures = (EXAMPLES / f"{self.name}.png", ENGINE / "validation" / f"{self.name}.png")
        found = next((picture for picture in pictures if picture.exists()), None)
        self.picture = f"![](../../../{found.relative_to(ROOT).as_posix()})" if found else ""

    def page(self) -> str:
        return (
            f"# {self.question}\n\n{self.text}\n\n{self.picture}\n\n"
            f"The script is `plant_examples/{self.name}.py`.\n\n"
            f"```{{literalinclude}} {self.path}\n:language: python\n:lines: {self.code}-\n```\n"
        )

    def card(self) -> str:
        picture = f"[{self.picture}]({self.name}.md)\n\n" if self.picture else ""
        return f"## [{self.question}]({self.name}.md)\n\n{picture}`{self.name}.py`\n\n"


def first_of_each(port: Port) -> bool:
    """Whether it stands for all variables that differ in their numbers only."""
    return set(re.findall(r"\[(\d+)\]", port.name)) <= {"1"}


def variables_page() -> str:
    """The variables of an FMU with two decks, [i] for every number."""
    lines = [
        "# Variables of the FMU",
        "",
        "Of a screen with two decks; with one, `intermediate` is not there. `[i]` stands for every "
        "class, deck or panel, counted from 1; classes from the finest, decks from the top, panels "
        "from the feed end. All are in SI units; tools show them in the unit behind the stroke.",
    ]
    titles = {"input": "Inputs", "output": "Outputs", "parameter": "Parameters"}
    found = ports(ScreenConfig.load(EXAMPLES / "screens" / "two_deck.toml"))
    for causality, title in titles.items():
        lines += ["", f"## {title}", "", "| name | unit / shown in | meaning |", "|---|---|---|"]
        for port in found:
            if port.causality == causality and first_of_each(port):
                unit = port.unit if port.kind == "Real" else port.kind
                shown = display_unit(port)
                tunable = ", tunable" if port.variability == "tunable" else ""
                name = port.name.replace("[1]", "[i]")
                meaning = re.sub(r"\b(class|deck|panel) 1\b", r"\1 i", port.description) + tunable
                if port.enumeration:
                    names = (item for item, _ in port.enumeration.items)
                    meaning += ": " + ", ".join(names)
                lines.append(f"| `{name}` | {unit}{shown} | {meaning} |")
    return "\n".join(lines) + "\n"


def display_unit(port: Port) -> str:
    """The unit that people at a plant see, behind a stroke."""
    display = UNITS[port.unit].display if port.display else None
    return f" / {display}" if display else ""


def solve_page() -> str:
    """The keys of the document that `vibroscreen solve --json` prints, and its schema."""
    lines = [
        "# What solve prints as JSON",
        "",
        "The keys of the document of `vibroscreen solve --json`: every one is there, no other. "
        "Units end the keys, as in the file of a screen; a figure without one is a share of one or "
        "a ratio. `null` is what there is nothing of, such as the P80 of a product without flow. "
        "{download}`The schema <solve.schema.json>` (JSON schema, draft 2020-12) says the same to "
        "programs.",
        "",
        "| key | meaning |",
        "|---|---|",
    ]
    lines += [f"| `{key}` | {text} |" for key, text in keys_of(schema(), "")]
    return "\n".join(lines) + "\n"


def keys_of(part: dict[str, Any], name: str) -> Iterator[tuple[str, str]]:
    """Keys below a part of a schema with what is said of each; of alike streams the first."""
    if "description" in part and name:
        yield name, part["description"]
    inside = part.get("properties", {})
    if "patternProperties" in part:
        inside = {"NAME": inside["feed"]}
    for key, below in inside.items():
        yield from keys_of(below, f"{name}.{key}" if name else key)
    items = part.get("items", {})
    if "properties" in items:
        for key, below in items["properties"].items():
            yield from keys_of(below, f"{name}[].{key}")


def write_pages(app: Sphinx) -> None:
    folder = HERE / "examples"
    folder.mkdir(exist_ok=True)
    examples = [Example(script) for script in sorted(EXAMPLES.glob("*.py"))]
    for page in folder.glob("*.md"):
        page.unlink()
    for example in examples:
        put(folder / f"{example.name}.md", example.page())
    names = "\n".join(example.name for example in examples)
    put(
        folder / "index.md",
        "# Plant questions\n\nEach example asks one question of a plant and answers it in its last "
        "line. They lie in `plant_examples/`.\n\n"
        + "".join(example.card() for example in examples)
        + f"```{{toctree}}\n:hidden:\n\n{names}\n```\n",
    )
    put(HERE / "fmu_variables.md", variables_page())
    put(HERE / "solve_json.md", solve_page())
    put(HERE / "solve.schema.json", json.dumps(schema(), indent=1) + "\n")


def put(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> None:
    app.add_html_math_renderer("mathml", (inline_math, None), (block_math, None))
    app.connect("builder-inited", write_pages)
    app.connect("source-read", read_elsewhere)
