"""Names of shape keys as other programs write them lead to the coefficients that they show."""

from __future__ import annotations

import re

import numpy as np
import pytest

from facemime.core.face.names import names_of, normalised
from facemime.core.heads.key_map import COEFFICIENTS, KeyMap, KeyRow
from facemime.core.heads.key_presets import ESSENTIAL, best_preset, known_expressions, presets, with_others
from tests.helpers.thorough import first_of


def words(name):
    """The words of a coefficient: eye, Blink, Left."""
    return re.findall(r"[A-Z]?[a-z]+", name)


def capitalised(name):
    return "".join(word.capitalize() for word in words(name))


WAYS = {
    "Maya": lambda i, name: f"BS_node.{name}",
    "Ready Player Me": lambda i, name: f"Wolf3D_Head.{name}",
    "MPFB": lambda i, name: f"!ex-{name}",
    "Rocketbox": lambda i, name: f"blendShape1.AK_{i + 1:02d}_{capitalised(name)}",
    "Character Creator 3": lambda i, name: f"A{i + 1:02d}_{'_'.join(words(capitalised(name)))}",
    "Daz": lambda i, name: f"Genesis9__facs_bs_{capitalised(name)}_div2",
    "a copy": lambda i, name: f"{name}.001",
    "numbers": lambda i, name: f"{i:02d}. {name}",
    "letters without a separator": lambda i, name: f"face{capitalised(name)}",
    "a suffix without a separator": lambda i, name: f"{name}Shape",
    "brackets": lambda i, name: f"{name} (ARKit)",
    "capitals": lambda i, name: f"EXP_FACE_{'_'.join(words(name)).upper()}",
    "sides before a suffix": lambda i, name: f"{name.replace('Left', '_L').replace('Right', '_R')}_mesh",
    "full-width letters": lambda i, name: "".join(chr(ord(letter) + 0xFEE0) for letter in name),
}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize("beside", first_of([0, 90]))
def test_the_coefficients_are_found_in_names_as_others_write_them(way, beside):
    keys = [way(i, name) for i, name in enumerate(COEFFICIENTS)]
    others = [f"AU_{i:02d}_Wrinkle{i}" for i in range(beside)]
    table = best_preset(["Basis", *others, *keys])
    assert table.short_name == "ARKit" and {row.source: row.key for row in table.rows} == dict(
        zip(COEFFICIENTS, keys, strict=True)
    )
    assert known_expressions([*others, *keys]) == keys


SETS = {
    "Character Creator 5": (
        "Eye_Blink_L Eye_Blink_R Jaw_Open Mouth_Corner_Pull_L Mouth_Corner_Pull_R Brow_Raise_In_L Brow_Raise_Outer_L "
        "Mouth_Funnel_UL Mouth_Funnel_UR Mouth_Funnel_DL Mouth_Funnel_DR Nose_Wrinkle_L"
    ),
    "MetaHuman": (
        "CTRL_expressions_eyeBlinkL CTRL_expressions_eyeBlinkR CTRL_expressions_jawOpen CTRL_expressions_browDownL "
        "CTRL_expressions_mouthCornerPullL CTRL_expressions_mouthCornerPullR CTRL_expressions_mouthFunnelUL "
        "CTRL_expressions_mouthFunnelUR CTRL_expressions_mouthFunnelDL CTRL_expressions_mouthFunnelDR "
        "CTRL_expressions_noseWrinkleL"
    ),
    "Character Creator 4": (
        "Eye_Blink_L Eye_Blink_R Jaw_Open Mouth_Smile_L Mouth_Smile_R Brow_Raise_Inner_L Brow_Raise_Inner_R "
        "Mouth_Pucker_Up_L Mouth_Pucker_Up_R Mouth_Pucker_Down_L Mouth_Pucker_Down_R"
    ),
    "Daz": (
        "facs_bs_JawOpen_div2 facs_bs_EyeBlinkLeft_div2 facs_bs_EyeBlinkRight_div2 facs_bs_MouthSmileLeft_div2 "
        "facs_bs_MouthPurseUpperLeft_div2 facs_bs_MouthPurseLowerLeft_div2 facs_bs_BrowInnerUpLeft_div2 "
        "facs_bs_MouthCloseUpperLeft_div2 facs_bs_MouthRollLowerRight_div2"
    ),
    "Daz Genesis 3 and 8": (
        "Genesis8Female__eCTRLSurprised Genesis8Female__eCTRLvAA Genesis8Female__eCTRLvOW "
        "Genesis8Female__eCTRLTongueIn-Out Genesis8Female__eCTRLNoseWrinkle Genesis8Female__eCTRLMouthSmileSimpleR "
        "Genesis8Female__eCTRLMouthSmileSimpleL Genesis8Female__eCTRLMouthSmile Genesis8Female__eCTRLMouthOpen "
        "Genesis8Female__eCTRLMouthFrown Genesis8Female__eCTRLMouthCornerBackR "
        "Genesis8Female__eCTRLMouthCornerBackL Genesis8Female__eCTRLLipTopUp-DownR "
        "Genesis8Female__eCTRLLipTopUp-DownL Genesis8Female__eCTRLLipsPucker Genesis8Female__eCTRLLipsPart "
        "Genesis8Female__eCTRLLipBottomUp-DownR Genesis8Female__eCTRLLipBottomUp-DownL "
        "Genesis8Female__eCTRLJawOut-In Genesis8Female__eCTRLEyesSquintR Genesis8Female__eCTRLEyesSquintL "
        "Genesis8Female__eCTRLEyesClosedR Genesis8Female__eCTRLEyesClosedL Genesis8Female__eCTRLEyesClosed "
        "Genesis8Female__eCTRLEyelidsUpperUp-DownL Genesis8Female__eCTRLCheeksBalloon "
        "Genesis8Female__eCTRLCheekEyeFlexR Genesis8Female__eCTRLCheekEyeFlexL Genesis8Female__eCTRLBrowSqueeze "
        "Genesis8Female__eCTRLBrowOuterUp-DownR Genesis8Female__eCTRLBrowOuterUp-DownL "
        "Genesis8Female__eCTRLBrowInnerUp-DownR Genesis8Female__eCTRLBrowInnerUp-DownL"
    ),
    "MikuMikuDance": (
        "あ い う え お まばたき 笑い ウィンク ウィンク右 ウィンク２ ｳｨﾝｸ２右 びっくり 怒り 困る 上 下 にやり 口角上げ"
    ),
    "VRChat": "vrc.v_sil vrc.v_pp vrc.v_aa vrc.v_oh vrc.v_ou vrc.v_th vrc.blink_left vrc.blink_right",
    "Unified Expressions": (
        "JawOpen EyeClosedLeft EyeClosedRight BrowInnerUpLeft MouthSmileLeft LipFunnelUpperLeft LipPuckerLowerRight "
        "CheekPuffLeft CheekPuffRight MouthRaiserUpper LipSuckLower"
    ),
    "SRanipal": (
        "Eye_Left_Blink Eye_Left_Wide Eye_Left_Right Eye_Left_Left Eye_Left_Up Eye_Left_Down Eye_Right_Blink "
        "Eye_Right_Wide Eye_Right_Right Eye_Right_Left Eye_Right_Up Eye_Right_Down Eye_Frown Eye_Left_Squeeze "
        "Eye_Right_Squeeze Jaw_Right Jaw_Left Jaw_Forward Jaw_Open Mouth_Ape_Shape Mouth_Upper_Right Mouth_Upper_Left "
        "Mouth_Lower_Right Mouth_Lower_Left Mouth_Upper_Overturn Mouth_Lower_Overturn Mouth_Pout Mouth_Smile_Right "
        "Mouth_Smile_Left Mouth_Sad_Right Mouth_Sad_Left Cheek_Puff_Right Cheek_Puff_Left Cheek_Suck "
        "Mouth_Upper_UpRight Mouth_Upper_UpLeft Mouth_Lower_DownRight Mouth_Lower_DownLeft Mouth_Upper_Inside "
        "Mouth_Lower_Inside Mouth_Lower_Overlay Tongue_LongStep1 Tongue_LongStep2 Tongue_Down Tongue_Up Tongue_Right "
        "Tongue_Left Tongue_Roll"
    ),
    "Mixamo Fuse": (
        "Blink_Left Blink_Right BrowsDown_Left BrowsDown_Right BrowsIn_Left BrowsIn_Right BrowsOuterLower_Left "
        "BrowsOuterLower_Right BrowsUp_Left BrowsUp_Right CheekPuff_Left CheekPuff_Right EyesWide_Left EyesWide_Right "
        "Frown_Left Frown_Right JawBackward JawForeward JawRotateY_Left JawRotateY_Right JawRotateZ_Left "
        "JawRotateZ_Right Jaw_Down Jaw_Left Jaw_Right Jaw_Up LowerLipDown_Left LowerLipDown_Right LowerLipIn "
        "LowerLipOut Midmouth_Left Midmouth_Right MouthDown MouthNarrow_Left MouthNarrow_Right MouthOpen MouthUp "
        "MouthWhistle_NarrowAdjust_Left MouthWhistle_NarrowAdjust_Right NoseScrunch_Left NoseScrunch_Right Smile_Left "
        "Smile_Right Squint_Left Squint_Right TongueUp UpperLipIn UpperLipOut UpperLipUp_Left UpperLipUp_Right"
    ),
    "MB-Lab": (
        "Expressions_browOutVertL_max Expressions_browOutVertL_min Expressions_browSqueezeL_max "
        "Expressions_browSqueezeR_max Expressions_browsMidVert_max Expressions_cheekSneerL_max "
        "Expressions_chestExpansion_max Expressions_eyeClosedL_max Expressions_eyeClosedL_min "
        "Expressions_eyeClosedPressureL_max Expressions_eyeClosedR_max Expressions_eyeSquintL_max "
        "Expressions_eyesHoriz_max Expressions_eyesVert_min Expressions_jawHoriz_max Expressions_jawOut_max "
        "Expressions_mouthClosed_max Expressions_mouthHoriz_max Expressions_mouthInflated_max "
        "Expressions_mouthOpenHalf_max Expressions_mouthOpenO_max Expressions_mouthOpen_max "
        "Expressions_mouthSmileL_max Expressions_mouthSmileR_max Expressions_mouthSmile_max Expressions_tongueOut_max"
    ),
    "FACS": "AU1 AU2_L AU2_R AU04 AU06 AU12_L AU12_R AU15 AU18 AU26 AU45_L AU45_R",
    "Rocketbox": (
        "AU_01_InnerBrowRaiser AU_02_L_OuterBrowRaiser AU_02_R_OuterBrowRaiser AU_02_OuterBrowRaiser AU_04_BrowLowerer "
        "AU_12_L_LipCornerPuller AU_12_R_LipCornerPuller AU_26_JawDrop AU_45_Blink"
    ),
}


@pytest.mark.parametrize("name", SETS)
def test_a_whole_face_is_found_in_the_keys_of_other_programs(name):
    keys = SETS[name].split()
    table = best_preset(keys)
    assert {"jawOpen", "eyeBlinkLeft", "eyeBlinkRight"} <= table.sources
    assert (name.split()[0] in table.name or name == "Daz") and len(table.keys) >= 0.5 * len(keys)


def test_an_eyelid_is_closed_once_where_a_mesh_has_keys_for_each_and_for_both():
    both = ["あ", "い", "う", "まばたき"]
    for more, wanted in (
        ((), "まばたき"),
        (("ウィンク", "ウィンク右"), "ウィンク"),
        (("ウィンク2", "ウィンク2右"), "ウィンク2"),
    ):
        table = best_preset([*both, *more])
        values = np.zeros((1, len(COEFFICIENTS)))
        values[0, [COEFFICIENTS.index(f"eyeBlink{side}") for side in ("Left", "Right")]] = 1.0
        posed = {key: of[0] for key, of in table.apply(values, dict.fromkeys([*both, *more], (0.0, 1.0))).items()}
        closed = {key for key, value in posed.items() if value}
        assert closed == {wanted, *([f"{wanted}右"] if more else [])} and all(posed[key] == 1.0 for key in closed)


@pytest.mark.parametrize(
    "keys",
    [
        "Blink Smile MouthOpen",
        "mouth_open blink.L blink.R smile.L smile.R",
        "EyesClosed JawDrop BrowsUp",
        "Wink_L Wink_R Open_Mouth",
        "L_Blink R_Blink Mouth_Open L_Smile R_Smile",
    ],
)
def test_keys_that_are_named_in_plain_words_are_found(keys):
    keys = keys.split()
    table = best_preset(["Basis", *keys])
    assert set(table.keys) == set(keys) and table.sources >= ESSENTIAL
    values = np.zeros((1, len(COEFFICIENTS)))
    values[0, [COEFFICIENTS.index(name) for name in (*ESSENTIAL, "mouthSmileLeft", "mouthSmileRight")]] = 1.0
    posed = table.apply(values, dict.fromkeys(keys, (0.0, 1.0)))
    assert {key for key, of in posed.items() if of[0] == 1.0} == {key for key in keys if "Brow" not in key}


VISEMES = [f"viseme_{name}" for name in "sil PP FF TH DD kk CH SS nn RR aa E I O U".split()]  # noqa: SIM905


def test_what_a_vocabulary_lacks_is_shown_by_the_keys_of_another():
    table = best_preset([*VISEMES, "eyeBlinkLeft", "eyeBlinkRight", "mouthSmileLeft", "mouthSmileRight"])
    assert table.sources >= ESSENTIAL
    shown = {row.source: row.key for row in table.rows}
    assert shown["jawOpen"] == "viseme_aa" and shown["eyeBlinkLeft"] == "eyeBlinkLeft"
    # A vowel that only resembles a smile makes way for one.
    assert [row.key for row in table.rows if row.source == "mouthSmileLeft"] == ["mouthSmileLeft"]
    without_jaw = [name for name in COEFFICIENTS if name != "jawOpen"]
    table = best_preset([*without_jaw, "Fcl_MTH_A", "Fcl_MTH_O", "Fcl_MTH_Fun"])
    assert {row.source: row.key for row in table.rows} == {
        **dict(zip(without_jaw, without_jaw, strict=True)),
        "jawOpen": "Fcl_MTH_A",
    }


def test_a_key_of_a_vocabulary_is_not_mistaken_for_one_of_another_name():
    # What MikuMikuDance calls a smile shuts the eyes.
    table = best_preset(["a", "i", "u", "e", "o", "blink", "smile"])
    assert "mouthSmileLeft" not in {row.source for row in table.rows if row.key == "smile"}


def test_keys_that_move_nothing_are_named_beside_those_that_do():
    moving = ["jawOpen", "eyeBlinkLeft", "eyeBlinkRight", "Fcl_MTH_Fun"]
    table = with_others(best_preset(moving), moving, [*moving, "cheekPuff", "Fcl_MTH_Joy"])
    assert "cheekPuff" in table.keys and "Fcl_MTH_Joy" not in table.keys


@pytest.mark.parametrize("first", ["{short}_{rest}", "{long}{rest}", "{long} {rest}"])
def test_a_side_may_come_first(first):
    def renamed(name: str) -> str:
        side = next((side for side in ("Left", "Right") if name.endswith(side)), "")
        rest = name.removesuffix(side)
        return first.format(short=side[0], long=side.lower(), rest=rest[0].upper() + rest[1:]) if side else name

    keys = [renamed(name) for name in COEFFICIENTS]
    table = best_preset(keys)
    assert {row.source: row.key for row in table.rows} == dict(zip(COEFFICIENTS, keys, strict=True))
    assert normalised("leftovers") == "leftovers"


def test_a_jaw_that_drops_behind_closed_lips_is_one_key_of_sranipal():
    keys = SETS["SRanipal"].split()
    values = np.zeros((1, len(COEFFICIENTS)))
    values[0, [COEFFICIENTS.index(name) for name in ("jawOpen", "mouthClose", "eyeLookInLeft")]] = 0.6, 0.4, 1.0
    posed = best_preset(keys).apply(values, dict.fromkeys(keys, (0.0, 1.0)))
    shown = {key: round(float(of[0]), 6) for key, of in posed.items() if of[0]}
    assert shown == {"Jaw_Open": 0.2, "Mouth_Ape_Shape": 0.4, "Eye_Left_Right": 1.0}


def test_a_name_with_a_suffix_is_not_taken_for_one_that_is_there():
    keys = [*COEFFICIENTS, *(f"old_{name}" for name in COEFFICIENTS)]
    assert set(best_preset(keys).keys) == set(COEFFICIENTS)


def test_a_word_is_no_prefix_because_a_few_names_have_it():
    names = names_of(["Hat_jawOpen", "Hat_Brim", "jawOpen"], {normalised(name) for name in COEFFICIENTS})
    assert names["Hat_jawOpen"] == {"hatjawopen"}


def test_no_table_takes_the_keys_of_another_for_its_own():
    for preset in presets():
        assert best_preset(preset.keys).name == preset.name


def test_a_table_says_how_much_it_can_show():
    full = presets()[0]
    assert full.summary() == "ARKit: 52 shape keys for all 52 movements."
    few = KeyMap("Mine", (KeyRow("jawOpen", "Open"), KeyRow("mouthFunnel", "Open"), KeyRow("mouthPucker", "Kiss")))
    assert few.summary() == "Mine: 2 shape keys for 3 of 52 movements, none of the brows."
    more = KeyMap("Mine", (*few.rows, KeyRow("browInnerUp", "Worried")))
    assert more.summary() == "Mine: 3 shape keys for 4 of 52 movements."
