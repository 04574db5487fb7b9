"""The page of a study: its charts, and importances only where trials suffice."""

import re

from tb2rl.tuning.page import write_page
from tb2rl.tuning.selection import TrialEvaluation
from tb2rl.tuning.storage import open_study
from tb2rl.tuning.trials import best_trials, run_trials


def test_a_page_has_importances_only_if_trials_suffice_and_numbers_of_trials_are_integers(
    make_folder, executor, untrained
):
    folder = make_folder()
    with open_study(folder) as study:
        pages = []
        for num_trials in (4, 10):
            run_trials(folder, study, num_trials, executor)
            best = best_trials(study)[0]
            file = write_page(folder, study, [TrialEvaluation(best.number, 3, 4, 1.0, "bullet")], best)
            pages.append(file.read_text(encoding="utf-8"))
    few, enough = pages
    shares = [re.findall(rf"<th>{key}</th>.*?</td>\n<td>([^<]*)</td></tr>", enough) for key in folder.space]
    assert all(re.fullmatch(r"[\d.]+\u202f%", share) for (share,) in shares)
    for page in pages:
        assert re.findall("<h3>(.*?)</h3>", page) == ["Scores", *folder.space]
        assert page.count("<svg") == 1 + len(folder.space)
    assert "need at least 10 complete trials" in few
    assert "need at least 10 complete trials" not in enough
    ticks = re.findall(r'id="chart-0-xtick_\d+".*?<text[^>]*>(.*?)</text>', few, re.DOTALL)
    assert ticks == ["0", "1", "2", "3"]
