"""The plan of a scene, before anything is rendered."""

from collections import Counter

from calibration.simulator.motion import Motion
from calibration.simulator.plan import damage, dataset_plan, recording_plan
from calibration.simulator.scene import load_scene, paper_scenes
from calibration.simulator.streams import Streams


def test_the_paper_plan_has_table_ones_counts_and_ten_presses_a_piece() -> None:
    """2520 sound and 158 damaged presses; every sound piece ten times at each of its positions."""
    plans = [plan for scene in paper_scenes() for plan in dataset_plan(scene, 0)]
    sound = [plan for plan in plans if not plan.kind]
    assert (len(sound), len(plans) - len(sound)) == (2520, 158)
    assert set(Counter((p.part, p.position, p.specimen) for p in sound).values()) == {10}
    assert len({plan.name for plan in plans}) == len(plans)


def test_damaged_pieces_are_no_sound_pieces_and_come_mixed_among_them() -> None:
    """No specimen is both; damaged presses are in the first and in the last third, so wear carries no information."""
    plans = dataset_plan(paper_scenes()[0], 0)
    sound, damaged = ({p.specimen for p in plans if bool(p.kind) is flag} for flag in (False, True))
    assert not sound & damaged
    for position in ("pos1", "pos2", "pos3", "pos4"):
        order = [bool(p.kind) for p in plans if p.position == position]
        third = len(order) // 3
        assert any(order[:third])
        assert any(order[-third:])


def test_a_gel_is_changed_after_1340_presses() -> None:
    """PZ1 alone needs two, and counts start again."""
    plans = dataset_plan(paper_scenes()[0], 0)
    assert {p.gel for p in plans} == {"gel1", "gel2"}
    assert max(p.gel_presses for p in plans) == 1339


def test_a_recordings_first_press_is_sound_and_the_given_number_is_damaged() -> None:
    """The demo's second run: 12 presses, 5 damaged, both kinds, mild to severe, other pieces than the first run."""
    scene = load_scene("demo")
    nominal, test = (recording_plan(scene, run, 3, 0.8) for run in scene.runs)
    assert [len(nominal), len(test)] == [24, 12]
    assert not any(p.kind for p in nominal)
    assert not test[0].kind
    assert sum(bool(p.kind) for p in test) == 5
    assert {p.kind for p in test if p.kind} == {"dent", "flattened_crest"}
    assert not {p.specimen for p in nominal} & {p.specimen for p in test}


def test_the_demos_damage_shows_for_many_seeds() -> None:
    """For ten seeds every damaged press of the demo has a mark of at least 40 pixels of imprint."""
    from calibration.simulator.field_of_view import LR
    from calibration.simulator.parts import PARTS
    from calibration.simulator.pose import Pose
    from calibration.simulator.renderer import Renderer

    scene = load_scene("demo")
    look, part = Renderer(LR, ("deformation",)), PARTS["PZ1"].positions["pos1"]
    for seed in range(10):
        for plan in recording_plan(scene, scene.runs[1], seed, 0.8):
            defect = damage(plan, scene, Streams(seed))
            if defect is not None:
                sound, damaged = look.imprints(part, defect, scene.press_depth_mm, Pose())
                assert look.mask(sound, damaged, scene.mask_depth_mm).sum() >= 40


def test_a_press_goes_down_rests_and_comes_up() -> None:
    """Phases come in order; depth is 0 before, within 3 % of full while settling, full while held, then falls."""
    moments = list(Motion(press_s=0.2, settle_s=0.2, hold_s=0.4, lift_s=0.2).moments(20))
    assert len(moments) == 26
    order = ("approach", "press", "settle", "hold", "lift")
    assert [order.index(m.phase) for m in moments] == sorted(order.index(m.phase) for m in moments)
    assert {m.phase for m in moments} == set(order)
    assert all(m.depth == 0 for m in moments if m.phase == "approach")
    assert all(0.97 <= m.depth < 1 for m in moments if m.phase == "settle")
    assert all(m.depth == 1 and m.slide_mm_s == 0 for m in moments if m.phase == "hold")
    lift = [m.depth for m in moments if m.phase == "lift"]
    assert lift == sorted(lift, reverse=True)
