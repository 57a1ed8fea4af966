"""Worker threads that request scores: order, costs, copies and giving up, with a scripted panel."""

import threading
from concurrent.futures import Future

import numpy as np
import pytest

from neoworld_mjx.config import MLLMOptions, SemanticOptions
from neoworld_mjx.errors import ModelError
from neoworld_mjx.mllm import Panel, Picture, Tape
from neoworld_mjx.mllm.ledger import Ledger
from neoworld_mjx.mllm.replay import Replay
from neoworld_mjx.mllm.requests import Response, Usage, digest
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.refinement import score_worker
from neoworld_mjx.refinement.score_log import ScoringJob
from neoworld_mjx.refinement.score_request import CRITERIA, Judgement
from neoworld_mjx.refinement.score_worker import EXTRA_WORKERS, ScoreWorkers
from neoworld_mjx.spec import SceneSpec
from tests.support import scenes

PHOTO = Picture.of("photo", np.zeros((8, 8, 3), np.uint8))


class Online(Replay):
    online = True


class Spent(Ledger):
    """A ledger whose sum the test sets."""

    spent_usd = 5.0


class ScriptedPanel(Panel):
    """Answers at once, with the levels or the error of the next entry; then with levels of 2."""

    def __init__(self, *script, online=True):
        provider = (Online if online else Replay)(Tape(), "none")
        super().__init__(provider, MLLMOptions(concurrency=1))
        self.script, self.asked = list(script), 0

    def ask_soon(self, request):
        self.asked += 1
        answer = self.script.pop(0) if self.script else 2
        future = Future()
        if isinstance(answer, Exception):
            future.set_exception(answer)
        elif answer is not None:
            levels = {name: {"reason": f"{name}.", "level": answer} for name in CRITERIA}
            usage = Usage(input=1000, output=500)
            judgement = Judgement.model_validate(levels)
            future.set_result(Response(judgement, "", usage, "some-model"))
        return future


@pytest.fixture(autouse=True)
def _single(monkeypatch):
    """One thread, as the panels request one score at a time."""
    monkeypatch.setattr(score_worker, "EXTRA_WORKERS", 0)


def job(iteration, candidate, rank=0):
    zero = Layout(*(np.zeros(s, np.float32) for s in ((1, 1, 2), (1, 1), (1, 1))))
    scene = scenes.on_table().model_copy(update={"name": f"{iteration} {candidate}"})
    return ScoringJob((iteration, candidate), rank, "0" * 16, zero, scene)


def picture_of(scene: SceneSpec):
    """A picture of its own for every candidate."""
    return np.full((4, 6, 3), [int(n) for n in f"{scene.name} 0".split()], np.uint8)


@pytest.fixture
def workers():
    """Makes workers, which end with the test."""
    opened = []

    def make(panel, draw=picture_of, **options):
        chosen = SemanticOptions(scorer="mllm", **options)
        opened.append(ScoreWorkers(panel, PHOTO, chosen, draw))
        return opened[-1]

    yield make
    for each in opened:
        each.close()


def test_awaited_candidates_come_first_then_by_iteration_rank_and_submission(workers):
    drawn, first, go = [], threading.Event(), threading.Event()

    def draw(scene):
        drawn.append(scene.name)
        first.set()
        assert go.wait(10)
        return picture_of(scene)

    pool = workers(ScriptedPanel(), draw)
    pool.put([job(0, 5)])
    assert first.wait(10)
    later = [job(1, 1, 0), job(1, 0, 1), job(0, 7, 3), job(0, 3, 2), job(0, 8, 3)]
    pool.put(later)
    assert len(pool._threads) == 1
    found = []
    waiting = threading.Thread(target=lambda: found.extend(pool.take(1, [(1, 0)], others=False)))
    waiting.start()
    for _ in range(5000):
        if pool._queue[0][1].identity == (1, 0):
            break
        waiting.join(0.001)
    pool.put([job(0, 0, 0)])
    go.set()
    waiting.join(10)
    rest = [(0, 0), (0, 3), (0, 5), (0, 7), (0, 8), (1, 1)]
    everything = pool.take("final", rest, others=True)
    assert drawn == ["0 5", "1 0", "0 0", "0 3", "0 7", "0 8", "1 1"]
    assert [(s.identity, s.used) for s in found] == [((1, 0), 1)]
    assert [s.identity for s in everything] == rest
    assert all(s.used == "final" for s in everything)


def test_a_score_has_its_cost_and_a_copy_is_free(workers):
    panel = ScriptedPanel(3, 1)
    pool = workers(panel, lambda scene: np.full((4, 6, 3), scene.name[-1] == "9", np.uint8))
    jobs = [job(0, 1), job(0, 2), job(0, 9)]
    pool.put(jobs)
    one, copy, other = pool.take(0, [each.identity for each in jobs], others=True)
    price = panel.ledger.prices[panel.options.critic.model]
    cost = price.cost(Usage(input=1000, output=500))
    assert cost > 0 and one.cost_usd == other.cost_usd == round(cost, 6)
    assert (one.value, copy.value, other.value) == (0.75, 0.75, 0.25)
    assert one.levels == dict.fromkeys(CRITERIA, 3)
    assert one.reasons == copy.reasons == {name: f"{name}." for name in CRITERIA}
    assert (one.cached, copy.cached, other.cached) == (False, True, False)
    assert copy.cost_usd == 0.0 and copy.identity == (0, 2) and copy.picture == one.picture
    assert panel.asked == 2 and one.model == "some-model"
    pixels = np.zeros((4, 6, 3), np.uint8)
    assert one.picture == digest(b"(4, 6, 3)" + pixels.tobytes())[:16]
    assert one.asked <= one.answered and 0 <= one.drawn_s < 1
    assert 0 <= pool.drawing_s < 1
    assert pool.cost_usd == 0.0  # The scripted panel charges nothing.


def test_an_answer_of_a_tape_is_free(workers):
    pool = workers(ScriptedPanel(4, online=False))
    pool.put([job(0, 0)])
    (score,) = pool.take(0, [(0, 0)], others=True)
    assert (score.value, score.cost_usd) == (1.0, 0.0)


def test_consecutive_failures_end_the_requests(workers):
    """Two failures, a success, then three failures: with three, the sixth ends it."""
    bad = ModelError("broken")
    panel = ScriptedPanel(bad, bad, 2, bad, bad, bad, 2)
    pool = workers(panel, give_up_after=3)
    jobs = [job(0, k, k) for k in range(8)]
    pool.put(jobs)
    scores = pool.take(0, [each.identity for each in jobs], others=True)
    assert panel.asked == 6
    assert pool.stopped == "3 consecutive scores failed; the last error: broken"
    assert [s.value for s in scores] == [None, None, 0.5, None, None, None, None, None]
    assert [s.error for s in scores[5:]] == ["broken", *[f"not requested: {pool.stopped}"] * 2]
    pool.put([job(1, 0)])
    (late,) = pool.take(1, [(1, 0)], others=True)
    assert late.error == f"not requested: {pool.stopped}" and panel.asked == 6


def test_failures_count_from_the_first_request(workers):
    panel = ScriptedPanel(ModelError("broken"), ModelError("broken"), 2)
    pool = workers(panel, give_up_after=2)
    pool.put([job(0, k, k) for k in range(3)])
    pool.take(0, [(0, k) for k in range(3)], others=True)
    assert panel.asked == 2 and pool.stopped is not None


def test_the_limit_of_costs_counts_what_this_search_spends(workers):
    panel = ScriptedPanel()
    panel.ledger = Spent(None, panel.ledger.prices)
    pool = workers(panel, max_cost_usd=1.0)
    pool.put([job(0, 0)])
    (score,) = pool.take(0, [(0, 0)], others=True)
    assert score.value == 0.5 and pool.cost_usd == 0.0
    panel.ledger.spent_usd = 6.0
    pool.put([job(0, 1)])
    (score,) = pool.take(0, [(0, 1)], others=True)
    assert score.error == "not requested: refine.semantic.max_cost_usd of 1 USD is reached"
    assert pool.cost_usd == 1.0 and panel.asked == 1


def test_a_candidate_that_cannot_be_drawn_fails_alone(workers):
    def draw(scene):
        if scene.name == "0 0":
            raise ValueError("no camera")
        return picture_of(scene)

    pool = workers(ScriptedPanel(), draw)
    pool.put([job(0, 0), job(0, 1)])
    bad, good = pool.take(0, [(0, 0), (0, 1)], others=True)
    assert bad.error == "cannot be rendered: no camera" and bad.asked is None and good.value == 0.5


def test_closing_abandons_what_is_pending(workers):
    pool = workers(ScriptedPanel(2, None))
    pool.put([job(0, 0), job(0, 1), job(0, 2)])
    assert pool.take(0, [(0, 0)], others=False)[0].value == 0.5
    rest = pool.close()
    assert [s.identity for s in rest] == [(0, 1), (0, 2)]
    assert all(s.error == "abandoned: the search had ended" and s.used is None for s in rest)
    assert pool.close() == []


def test_some_more_candidates_are_drawn_than_are_requested_at_once(workers, monkeypatch):
    assert EXTRA_WORKERS == 2
    for ahead in (0, 2, 5):
        monkeypatch.setattr(score_worker, "EXTRA_WORKERS", ahead)
        panel = ScriptedPanel()
        panel.options = panel.options.model_copy(update={"concurrency": 3})
        pool = workers(panel)
        pool.put([job(0, 0)])
        pool.put([job(0, 1)])
        assert len(pool._threads) == 3 + ahead
