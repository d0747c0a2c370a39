"""The curriculum graph of a page."""

import curricle as cr
from curricle.show.graph import CARD, graphs

from .studies import hunt_plan, shown


def graphs_of(results):
    record, learnt, _ = shown(results)
    reasons = {(arm, task): ["all steps used"] for arm, nodes in learnt.items() for task in nodes}
    return graphs(record, learnt, reasons)


def test_arms_with_the_same_tasks_and_transfers_share_a_graph(pursuit, maze):
    (graph,) = graphs_of(pursuit.results)
    assert graph.arms == ("min", "mean")
    assert [card.name for card in graph.cards] == ["chase", "hunt"]
    assert [curve.arms for curve in graph.cards[0].curves] == [("min", "mean")]
    assert [curve.arms for curve in graph.cards[1].curves] == [("min",), ("mean",), ("scratch",)]
    (edge,) = graph.edges
    assert [words.split(";")[0] for words in edge.words] == [
        "predator is predator_1, prey by name",
        "predator is predator_2, prey by name",
    ]
    assert graph.notes == (
        "min: hunt uses the minimum of its transfers.",
        "mean: hunt uses the mean of its transfers.",
    )
    # Both corners are called "corner", and are not one task.
    assert [graph.arms for graph in graphs_of(maze.results)] == [("2x2",), ("3x3",)]


def test_a_source_that_is_not_evaluated_has_no_curve(recwarn):
    maze, corner = cr.GridWorld("S..T"), cr.GridWorld("S.T")
    plan = cr.Curriculum(
        tasks={"corner": corner, "maze": maze},
        transfers=[cr.Transfer("corner", "maze", cr.same_position(maze, corner))],
        budget=200,
        evaluation={"corner": cr.GreedyEvaluation("off")},
    )
    (graph,) = graphs_of({"transfer": plan.train(2)})
    source, target = graph.cards
    assert source.curves == ()
    assert len(target.curves) == 1
    assert source.height < target.height
    assert not recwarn.list


def test_a_scaled_transfer_makes_another_graph(pursuit):
    scaled = hunt_plan(cr.minimum, scale=2.0).train(2)
    found = graphs_of({**pursuit.results, "scaled": scaled})
    assert [graph.arms for graph in found] == [("min", "mean"), ("scaled",)]
    assert all("scaled by 2" in words for words in found[1].edges[0].words)


def test_cards_do_not_overlap_and_arrows_lead_down():
    maze = cr.GridWorld(["...T", "....", "S..."])
    tasks = dict.fromkeys("abcd", maze)
    pairs = [("a", "c"), ("b", "c"), ("c", "d"), ("a", "d")]
    edges = [cr.Transfer(*pair, cr.transfer.identity(maze)) for pair in pairs]
    result = cr.Curriculum(tasks, edges, budget=100).train()
    (graph,) = graphs_of({"both": result})
    top = {card.name: card.top for card in graph.cards}
    for edge in graph.edges:
        assert top[edge.source] < top[edge.target]
        assert 0 <= edge.place[0] <= graph.width
    boxes = [(card.left, card.top, card.height) for card in graph.cards]
    for i, (left, up, height) in enumerate(boxes):
        assert 0 <= left <= graph.width - CARD
        assert up + height <= graph.height
        for x, y, tall in boxes[:i]:
            apart = abs(left - x) >= CARD or up >= y + tall or y >= up + height
            assert apart
    (skipping,) = [edge for edge in graph.edges if (edge.source, edge.target) == ("a", "d")]
    (card,) = [card for card in graph.cards if card.name == "c"]
    assert not card.left <= skipping.place[0] <= card.left + CARD
