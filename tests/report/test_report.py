"""Reports: valid pages, the numbers of the API, texts of files as texts, pictures that hold."""

from __future__ import annotations

import base64
import math
import re
import unicodedata
from itertools import chain
from pathlib import Path
from xml.etree import ElementTree

import html5lib
import pypdf
import pytest

from tests.fixed import FIXED
from tests.places import ROOT, SCREENS
from vibroscreen import Feed, InputError, Screen, ScreenConfig, report
from vibroscreen.report import contents
from vibroscreen.report.contents import BOX, DECK, LOAD, RULES, UNITS, text_of
from vibroscreen.report.specification import Specification, read_specification
from vibroscreen.sections import Deck, Panel, Segregation
from vibroscreen.sizing_rules import rules_of
from vibroscreen.steady import SteadyResult
from vibroscreen.units import KW, MM, PERCENT, T_H

DOUBLE = ScreenConfig.load(ROOT / "tests" / "data" / "cases" / "double_deck.toml").replace(**FIXED)
BANANA = ScreenConfig.load(SCREENS / "banana.toml")
HOSTILE = (
    "</title></style><script>alert(1)</script><img src=x onerror='alert(2)'>\" & &amp; {{ 7 * 7 }} "
    "{% raw %} $x_1$ \x01\x7f\x9f\u202eevil\ufffe"
)


@pytest.fixture(scope="module")
def double() -> SteadyResult:
    return Screen(DOUBLE).solve_steady()


@pytest.fixture(scope="module")
def banana() -> SteadyResult:
    return Screen(BANANA).solve_steady()


@pytest.fixture
def _one_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same small picture in the place of every one, where only words and numbers count."""
    monkeypatch.setattr(
        contents, "_picture", lambda figure, name, says: contents.Picture("data:,", name, says)
    )


def parsed(page: str) -> ElementTree.Element:
    """The tree of a page that a strict parser of HTML takes without a fault."""
    return html5lib.HTMLParser(strict=True, namespaceHTMLElements=False).parse(page)


def text(element: ElementTree.Element | None) -> str:
    assert element is not None
    return "".join(element.itertext())


def rows(tree: ElementTree.Element) -> dict[str, list[list[float]]]:
    """Exact values of every row of a table, by its first cell; rows of one name in their order."""
    found: dict[str, list[list[float]]] = {}
    for row in tree.iter("tr"):
        head = row.find("th")
        if head is not None:
            values = [
                float(cell.attrib["value"])
                for cell in chain(*(td.iter("data") for td in row.iter("td")))
            ]
            found.setdefault(text(head), []).append(values)
    return found


def same(found: list[float], wanted: list[float]) -> bool:
    return len(found) == len(wanted) and all(
        a == b or (math.isnan(a) and math.isnan(b)) for a, b in zip(found, wanted, strict=True)
    )


@pytest.fixture(scope="module")
def page(double: SteadyResult) -> str:
    return report.html(double)


def test_the_page_is_valid_and_whole_in_itself(
    page: str, double: SteadyResult, banana: SteadyResult
) -> None:
    decks = tuple(
        Deck(2.4, (Panel(3.0, 0.2, 1.2 * size * MM), Panel(3.0, 0.1, size * MM)))
        for size in (45.0, 22.0, 11.0, 4.0)
    )
    four = Screen(ScreenConfig.default().replace(decks=decks)).solve_steady()
    band = Specification("intermediate[3]", [4.0 * MM, 11.0 * MM], [0.0, 0.9], [0.1, 1.0])
    for one in (page, report.html(double, banana), report.html(four, four, [band])):
        tree = parsed(one)
        assert len(one.encode()) < 1e6
        assert tree.find("head/meta[@name='viewport']") is not None
        assert [
            tag
            for tag in ("script", "link", "iframe", "form")
            if tree.find(f".//{tag}") is not None
        ] == []
        assert not re.search(r"https?:|url\(|@import", one.split("</head>")[0])
        images = list(tree.iter("img"))
        assert len(images) >= 8
        for image in images:
            kind, _, data = image.attrib["src"].partition(",")
            assert kind == "data:image/svg+xml;base64"
            assert ElementTree.fromstring(base64.b64decode(data)).tag.endswith("svg")
            assert image.attrib["alt"]
        assert not [e for e in tree.iter() if any(name.startswith("on") for name in e.attrib)]


def test_every_deck_has_the_numbers_of_its_result(page: str, double: SteadyResult) -> None:
    found = rows(parsed(page))
    for figure in (*DECK, *LOAD):
        wanted = [getattr(deck, figure.scalar) for deck in double.decks]
        assert any(same(values, wanted) for values in found[figure.label]), figure.label
    for figure in RULES:
        wanted = [getattr(rule, figure.scalar) for rule in rules_of(DOUBLE)]
        assert any(same(values, wanted) for values in found[figure.label]), figure.label
    for figure in BOX:
        assert [getattr(double, figure.scalar)] in found[figure.label]
    body = text(parsed(page).find("body"))
    for deck in double.decks:  # what an engineer reads
        assert f"{100.0 * deck.efficiency:.1f}" in body


def test_products_have_the_numbers_of_their_streams(page: str, double: SteadyResult) -> None:
    found = rows(parsed(page))
    streams = list(double.streams.values())
    assert found["rate"] == [[stream.mass_flow_rate for stream in streams]]
    assert math.fsum(found["rate"][0][1:]) == pytest.approx(found["rate"][0][0], rel=1e-12)
    for k, edge in enumerate(double.size_classes.edges):
        assert found[f"below {text_of(edge, 'mm')} mm"] == [[s.passing[k] for s in streams]]
    assert same(
        found["P80"][0],
        [double.feed_p80, double.undersize_p80, *double.intermediate_p80, double.oversize_p80],
    )


@pytest.mark.usefixtures("_one_picture")
def test_two_screens_stand_side_by_side(double: SteadyResult, banana: SteadyResult) -> None:
    tree = parsed(report.html(double, banana))
    found = rows(tree)
    both = [*double.decks, *banana.decks]
    for figure in (*DECK, *LOAD):
        wanted = [getattr(deck, figure.scalar) for deck in both]
        assert any(same(values, wanted) for values in found[figure.label]), figure.label
    heads = [text(head) for head in tree.iter("h1")]
    assert heads == [f"A {DOUBLE.name}", f"B {BANANA.name}"]
    assert [double.drive_power, banana.drive_power] in found["power of the drive"]
    # A row a key: the value of both, a dash for what acts in one of them only.
    cells = {
        text(head): [text(td) for td in row.iter("td")]
        for row in tree.iter("tr")
        if (head := row.find("th")) is not None
    }
    assert cells["displacement.model"][:2] == ["A rigid_body", "B prescribed"]
    assert cells["displacement.velocity_m_s"][:2] == ["A \N{EN DASH}", "B 0.45"]


@pytest.mark.usefixtures("_one_picture")
@pytest.mark.parametrize("name", [HOSTILE, "<n" * 25_000, "\n\t"])
def test_names_from_files_are_texts(
    name: str, double: SteadyResult, page: str, tmp_path: Path
) -> None:
    config = ScreenConfig.loads(DOUBLE.replace(name=name).to_toml())
    assert config.name == name
    one = report.html(config)
    tree = parsed(one)
    tags = [element.tag for element in tree.iter()]
    assert tags == [element.tag for element in parsed(page).iter()]
    shown = re.sub("[\x01\x7f\x9f\u202e\ufffe]", "\N{REPLACEMENT CHARACTER}", name)
    head = text(next(tree.iter("h1")))
    assert head.rstrip("\N{HORIZONTAL ELLIPSIS}") in (" ".join(shown.split()) or "no name")
    assert len(head) <= 91
    listing = text(next(tree.iter("pre")))
    assert (
        ScreenConfig.loads(listing.replace("\N{REPLACEMENT CHARACTER}", "?")).decks == config.decks
    )
    assert len(one.encode()) < 1e6


# --- what it rests on ----------------------------------------------------------------------------
OWN = """name = "our <i>stone</i>"
fitted_to = "4 runs of 200 to 800 t/h"
rmse = 0.018
[passage]
relative_velocity = 0.5
[range]
aperture_mm = [10, {most}]
"""


@pytest.mark.usefixtures("_one_picture")
@pytest.mark.parametrize(
    ("most", "said"), [(40, "Calibrated."), (12, "Calibrated, but not for all of this.")]
)
def test_what_it_was_calibrated_on(most: int, said: str, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(OWN.format(most=most), encoding="utf-8")
    (tmp_path / "screen.toml").write_text(
        """[size_classes]
edges_mm = [0, 2, 4, 8, 16, 31.5, 63]
[material]
calibration = "own.toml"
""",
        encoding="utf-8",
    )
    config = ScreenConfig.load(tmp_path / "screen.toml")
    (box,) = boxes(report.html(config))
    assert text(box.find("p")).startswith(said)
    whose = "those of our <i>stone</i>, fitted to 4 runs of 200 to 800 t/h, with a root mean square"
    assert whose in " ".join(text(box).split())
    assert ("known" in box.attrib["class"]) == (most == 40)
    assert [text(li) for li in box.iter("li")] == config.beyond_calibration()


@pytest.mark.usefixtures("_one_picture")
def test_what_was_not_calibrated_is_said(banana: SteadyResult) -> None:
    first, second = boxes(report.html(ScreenConfig.default(), banana))
    for box, config in ((first, ScreenConfig.default()), (second, BANANA)):
        assert text(box.find("p")).startswith("Not calibrated on this screen.")
        assert config.calibration.fitted_to in " ".join(text(box).split())
        assert "known" not in box.attrib["class"]
        assert [text(li) for li in box.iter("li")] == config.beyond_calibration()
    assert len(list(second.iter("li"))) > 4  # a banana screen is steep, its velocity prescribed


def boxes(page: str) -> list[ElementTree.Element]:
    """The boxes that say what the numbers of a screen rest on."""
    return [e for e in parsed(page).iter("div") if e.attrib.get("class", "").startswith("box")]


# --- PDF -----------------------------------------------------------------------------------------
def test_the_pdf_holds_the_numbers_and_the_names(double: SteadyResult, tmp_path: Path) -> None:
    path = report.write(DOUBLE.replace(name="<script>$x$ & 'name'"), tmp_path / "screen.pdf")
    pages = [one.extract_text() for one in pypdf.PdfReader(path).pages]
    assert path.stat().st_size < 1e6
    assert 4 <= len(pages) <= 9
    whole = unicodedata.normalize("NFKC", " ".join(" ".join(pages).split()))  # of ligatures
    assert "<script>$x$ & 'name'" in whole
    for figure in DECK:
        wanted = " ".join(
            text_of(getattr(deck, figure.scalar), figure.unit) for deck in double.decks
        )
        assert f"{figure.label} {figure.unit} {wanted}".replace("  ", " ") in whole, figure.label
    assert "vibroscreen" in whole
    assert f"1 / {len(pages)}" in " ".join(pages[0].split())


# --- what there is nothing of --------------------------------------------------------------------
def test_a_feed_without_undersize_has_a_report() -> None:
    """Dashes for what there is nothing of, no map of a deck that gets nothing."""
    share = (0.0,) * (DOUBLE.size_classes.count - 1) + (1.0,)
    steady = Screen(DOUBLE).solve_steady(Feed(50.0, share))
    page = report.html(steady)
    cells = {
        text(row.find("th")): row for row in parsed(page).iter("tr") if row.find("th") is not None
    }
    shown = [text(td) for td in cells["efficiency: undersize that passes"].iter("td")]
    assert shown == ["%", "\N{EN DASH}", "\N{EN DASH}"]
    assert page.count('alt="Map of the bed of deck 1"') == 2
    assert "Map of the bed of deck 2" not in page


def test_a_model_without_layers_has_no_map() -> None:
    mixed = DOUBLE.replace(segregation=Segregation("well_mixed"))
    page = report.html(mixed)
    assert "Map of the bed" not in page
    told = "The segregation model well_mixed knows no layers, so there is no map of the bed."
    assert told in text(parsed(page).find("body"))


def test_what_cannot_be_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"report = .*screen.docx has no suffix .*: give .html or .pdf"
    ):
        report.write(DOUBLE, tmp_path / "screen.docx")


# --- specification -------------------------------------------------------------------------------
BAND = """# limits of the fine product
size_mm, least_percent, most_percent, product
10, 95, , undersize
2.5, 30, 45, undersize
5,   70, 80, undersize
16,  , 90, intermediate[1]
"""


@pytest.mark.usefixtures("_one_picture")
def test_products_against_their_specification(double: SteadyResult, tmp_path: Path) -> None:
    path = tmp_path / "band.csv"
    path.write_text(BAND, encoding="utf-8")
    fine, _ = read_specification(path)
    assert fine.product == "undersize"
    assert fine.size.tolist() == pytest.approx([2.5e-3, 5e-3, 10e-3])
    assert fine.most.tolist() == pytest.approx([0.45, 0.80, 1.0])
    readings = fine.readings(double.size_classes.edges, double.undersize)
    at = dict(zip(double.size_classes.edges, double.undersize.passing, strict=True))
    assert [r.passing for r in readings] == [at[2.5 * MM], at[5.0 * MM], at[10.0 * MM]]
    assert [r.met for r in readings] == [False, True, True]
    finer = f"{100.0 * at[2.5 * MM]:.1f}"
    tree = parsed(report.html(double, specification=path))
    lights = {" ".join(text(li).split()) for li in tree.iter("li") if "specification" in text(li)}
    assert lights == {
        f"act: undersize, specification {finer} % finer than 2.5 mm, not 30.0 to 45.0 %",
        "good: intermediate 1, specification within its limits at 1 sizes",
    }


def test_between_limits_of_classes_the_mass_lies_evenly(double: SteadyResult) -> None:
    band = Specification("undersize", [3.5 * MM], [0.0], [1.0])
    at = dict(zip(double.size_classes.edges, double.undersize.passing, strict=True))
    low, high = at[2.5 * MM], at[5.0 * MM]
    (reading,) = band.readings(double.size_classes.edges, double.undersize)
    assert reading.passing == pytest.approx(low + 0.4 * (high - low))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("most_percent", "most_per_cent"), "column 'most_per_cent' is unknown: did you mean 'most_percent'?"),
        ((", most_percent", ""), "column 'most_percent' is missing: a specification has size_mm, least_percent and most_percent"),
        (("2.5, 30, 45", "2.5, 30, no"), "line 4: most_percent = 'no' is not a number: give one"),
        (("2.5, 30, 45", "2.5, 30"), "line 4 has not 4 cells as the head"),
        (("2.5, 30, 45", "2.5, 30, 450"), "specification of undersize at 2.5 mm: 450 % passing is out of range (0 to 100 %)"),
        (("2.5, 30, 45", "2.5, 45, 30"), "specification of undersize at 2.5 mm: at least 45 % and at most 30 % exclude each other: swap them"),
        (("2.5, 30, 45", "5, 30, 45"), "specification of undersize at 5 mm: not larger than the size before, 5 mm: give every size once"),
        (("2.5, 30, 45", "0, 30, 45"), "specification of undersize at 0 mm: not a finite size above 0: give the opening of a sieve"),
        (("2.5, 30, 45", "nan, 30, 45"), "specification of undersize at nan mm: not a finite size above 0: give the opening of a sieve"),
        ((BAND.partition("\n")[2].partition("\n")[2], ""), "the specification holds no rows: give one a size"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_specification(
    change: tuple[str, str], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "band.csv"
    assert change[0] in BAND
    path.write_text(BAND.replace(*change, 1), encoding="utf-8")
    with pytest.raises(InputError) as refusal:
        read_specification(path)
    assert str(refusal.value) == message
    assert refusal.value.__notes__ == [f"in {path}"]


def test_a_product_that_is_none(double: SteadyResult) -> None:
    band = Specification("underflow", [1e-3], [0.0], [1.0])
    message = (
        "specification: 'underflow' is no product of this screen: did you mean 'undersize'? It has "
        "feed, undersize, intermediate[1], oversize"
    )
    with pytest.raises(InputError, match=re.escape(message)):
        report.html(double, specification=[band])


# --- numbers -------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("value", "unit", "shown"),
    [
        (0.62814, "%", "62.8"),
        (97.22222222222223, "t/h", "350"),
        (12.3456 * MM, "mm", "12.35"),
        (13768.4, "kW", "13.77"),
        (123456.0, "kg", "123500"),
        (1.25e-5, "", "0.0000125"),
        (math.nan, "mm", "\N{EN DASH}"),
        (0.0, "t/h", "0"),
    ],
)
def test_numbers_have_four_digits(value: float, unit: str, shown: str) -> None:
    assert text_of(value, unit) == shown
    assert {"%": PERCENT, "t/h": T_H, "kW": KW}.items() <= UNITS.items()
