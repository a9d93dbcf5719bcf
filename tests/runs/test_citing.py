"""What is cited for a method: its learner's paper, those of its terms, and this package as CITATION.cff has it."""

import re
from pathlib import Path

import pytest

import odaf
from golden.runs import scored_run
from odaf.algorithms import citations
from odaf.cli import main
from odaf.errors import ConfigError
from odaf.runs import citing, presets

ROOT = Path(__file__).parents[2]
CFF = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
ALL = [entry for entry in vars(citations).values() if isinstance(entry, citations.Citation)]


def keys(method: str) -> dict[str, list[str]]:
    return {part.name: [citation.key for citation in part.citations] for part in citing.parts_of(method)}


def test_a_method_is_its_learner_and_its_terms():
    assert keys("odaf-rorl") == {
        "learner ensemble-sac": ["an2021edac"],
        "term policy_smoothing": ["yang2022rorl"],
        "term value_smoothing": ["yang2022rorl"],
        "term ood": ["bai2022pbrl", "yang2022rorl"],
        "term outcome": ["jiang2025odaf"],
    }
    assert keys("pbrl-prior") == {
        "learner ensemble-sac": ["an2021edac", "osband2018priors"],
        "term ood": ["bai2022pbrl"],
    }
    assert keys("osr")["learner ensemble-sac"] == ["haarnoja2018sac"]
    assert keys("td3-bc") == {"learner td3-bc": ["fujimoto2021td3bc"]}
    assert keys("iql") == {"learner iql": ["kostrikov2022iql"]}
    assert keys("cql") == {"learner cql": ["kumar2020cql", "haarnoja2018sac"]}
    assert keys("atac") == {"learner atac": ["cheng2022atac"]}
    assert keys("rebrac") == {"learner rebrac": ["tarasov2023rebrac"]}
    assert keys("spot") == {"learner spot": ["wu2022spot"]}
    assert keys("svr") == {"learner svr": ["mao2023svr"]}
    assert keys("scas") == {"learner scas": ["mao2024scas"]}
    assert keys("brac-p") == keys("brac-v") == {"learner brac": ["wu2019brac"]}
    assert keys("bcq") == {"learner bcq": ["fujimoto2019bcq"]}
    assert keys("bear") == {"learner bear": ["kumar2019bear"]}
    assert keys("diversity") == {"term diversity": ["an2021edac"]}


def test_rows_that_are_not_drawn_all_alike_are_cited(tmp_path):
    run = scored_run(tmp_path / "run", {}, "mine", terms=[], num_critics=4, sampling="advantage")
    by = "rows drawn by sampling='advantage'"
    assert keys(str(run)) == {"learner ensemble-sac": ["an2021edac"], by: ["hong2023harnessing", "hong2023beyond"]}
    assert keys("behaviour-cloning-best")["rows drawn by sampling='best'"] == ["chen2021decision"]
    assert list(keys("behaviour-cloning")) == ["learner behaviour-cloning"]


@pytest.mark.parametrize("name", presets.names())
def test_every_preset_has_papers(name):
    assert all(keys(name).values())


def test_a_run_is_cited_without_the_terms_that_were_off(tmp_path):
    terms = [{"name": "outcome", "weight": 0.0}, {"name": "diversity", "weight": 1.0}]
    run = scored_run(tmp_path / "run", {}, "mine", terms=terms, num_critics=4)
    assert keys(str(run)) == {"learner ensemble-sac": ["an2021edac"], "term diversity": ["an2021edac"]}


def test_a_folder_of_runs_cites_them_all(tmp_path):
    for name in ("a", "b"):
        scored_run(tmp_path / name, {}, "mine", terms=[{"name": "diversity", "weight": 1.0}], num_critics=4)
    text = citing.bibliography([str(tmp_path)], "text")
    assert text.splitlines()[:1] + text.splitlines()[3:4] == [str(tmp_path / "a"), str(tmp_path / "b")]
    assert text.count("[an2021edac]") == 1


def test_bibtex_holds_each_paper_once_in_the_words_of_the_paper(capsys: pytest.CaptureFixture[str]):
    assert main(["cite", "odaf-rorl", "rorl"]) == 0
    out = capsys.readouterr().out
    assert re.findall(r"^@\w+\{(.*),$", out, re.MULTILINE) == [
        "an2021edac",
        "yang2022rorl",
        "bai2022pbrl",
        "jiang2025odaf",
        "odaf",
    ]
    assert (
        "@misc{jiang2025odaf,\n"
        "  author = {Ke Jiang and Wen Jiang and Yao Li and Xiaoyang Tan},\n"
        "  title = {{Beyond Non-Expert Demonstrations: Outcome-Driven Action Constraint for Offline Reinforcement "
        "Learning}},\n"
        "  year = {2025},\n  eprint = {2504.01719},\n  archivePrefix = {arXiv},\n}"
    ) in out
    comments = [line for line in out.splitlines() if line.startswith("%")]
    assert "%   term outcome: jiang2025odaf" in comments
    outside = re.sub(r"^@\w+\{.*?^\}", "", out, flags=re.MULTILINE | re.DOTALL)
    assert all(line.startswith("%") or not line for line in outside.splitlines())


def test_text_is_a_line_a_paper(capsys: pytest.CaptureFixture[str]):
    assert main(["cite", "td3-bc", "--format", "text"]) == 0
    assert (
        "[fujimoto2021td3bc] Scott Fujimoto and Shixiang Shane Gu. A Minimalist Approach to Offline Reinforcement "
        "Learning. Advances in Neural Information Processing Systems. arXiv 2106.06860, 2021.\n"
        f"[odaf] The odaf contributors. odaf. Software, version {odaf.__version__}.\n"
    ) in capsys.readouterr().out


def test_this_package_is_cited_as_its_citation_file_says():
    """CITATION.cff does not travel with the installed package, so the two are held together here."""
    own = citations.software(odaf.__version__)
    assert f"title: {own.title}\n" in CFF and f"- name: {own.authors[0]}\n" in CFF
    assert f"version: {odaf.__version__}\n" in CFF
    preferred = CFF.split("preferred-citation:")[1]
    assert f'title: "{citations.ODAF.title}"' in preferred and f"year: {citations.ODAF.year}\n" in preferred
    names = re.findall(r"given-names: (.*)\n\s+family-names: (.*)\n", preferred)
    assert [" ".join(name) for name in names] == list(citations.ODAF.authors)
    assert f"arXiv:{citations.ODAF.arxiv}" in preferred


@pytest.mark.parametrize("citation", ALL, ids=lambda citation: citation.key)
def test_records_are_in_order(citation):
    assert len({entry.key for entry in ALL}) == len(ALL)
    assert all(re.fullmatch(r"\S+( \S+)+", author) for author in citation.authors)
    assert 1980 < citation.year < 2030
    assert not citation.arxiv or re.fullmatch(r"\d{4}\.\d{4,5}", citation.arxiv)
    assert citation.arxiv or citation.venue
    assert citation.bibtex().count("{") == citation.bibtex().count("}")


def test_what_has_no_papers_says_so_and_what_is_unknown_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(odaf.BehaviourCloning, "citations", lambda self: ())
    assert "learner behaviour-cloning: has no citation of its own" in citing.bibliography(["behaviour-cloning"])
    with pytest.raises(ConfigError, match="is no preset, learner, term or run directory; did you mean 'odaf-rorl'?"):
        citing.parts_of("odaf-rrol")
    with pytest.raises(ConfigError, match="known are: .*behaviour-cloning, .*edac, "):
        citing.parts_of("xyzzy")


def test_cite_without_a_method_says_what_to_name(capsys: pytest.CaptureFixture[str]):
    assert main(["cite"]) == 2
    assert "name at least one method" in capsys.readouterr().err
