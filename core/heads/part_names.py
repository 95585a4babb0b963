"""What names say about a character: those of objects and materials about the parts of its face, and those of bones.

Names are compared word by word, as "brow" is part of "brown" and "face" of "surface". Words may be joined
(`EyeLeft`, `eye_left`, `eyeleft`), and have a side, a row or what artists append to names of meshes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from .rig import Part

_BEFORE = (
    r"(?:l|r|left|right|both|upper|lower|top|bottom|front|back|inner|outer|base|my|male|female|man|woman|human|"
    r"character|std|default)?"
)
_AFTER = r"(?:s|es|l|r|left|right|upper|lower|top|bottom|inner|outer|mesh|geo|geometry|obj|object|mat|material|base)*"
_EYE = r"eyes? ?"
_LEFT, _RIGHT = {"l", "left"}, {"r", "right"}
_AFFIXES = {
    "base",
    "mixamorig",
    "bip",
    "biped",
    "valve",
    "facial",
    "master",
    "def",
    "adj",
    "j",
    "c",
    "cc",
    "b",
    "x",
    "smplhf",
}
"""Words that rigs put before or after a name, or that mark a bone as deforming or central."""
_NATIVE_BONES = {"左": "left", "右": "right", "目": "eye", "眼": "eye", "頭": "head", "头": "head"}
"""Words of MMD's bones, and of Chinese ones. MMD's 両目 turns both eyes, each of which has a bone of its own."""
_HEADS = ({"head"}, {"skull"}, {"kopf"}, {"tete"})
_JAWS = ({"jaw"}, {"jawbone"}, {"jaw", "root"}, {"mandible"})
_EYE_BONES = ({"eye"}, {"face", "eye"}, {"eyeball"}, {"eye", "socket"})


def _words(*patterns: str) -> re.Pattern[str]:
    """Compile patterns of whole words, whose words are separated by an optional space."""
    joined = "|".join(pattern.replace("_", " ?") for pattern in patterns)
    return re.compile(rf"(?<= ){_BEFORE}(?:{joined}){_AFTER}(?= )")


_ON_SKIN = _words(
    rf"(?:{_EYE})?(?:lash|brow)(?:e?s)?(?:_(?:card|line|hair|fur)s?)?",
    r"face_brow",
    r"(?:beard|goatee|whisker|stubble|side_?burn)",
    r"mo?usta(?:ch|sh)e?",
    rf"{_EYE}(?:liner?|shadow|occlusion|wetness|moisture|blend|edge|shell|crease)",
    r"occlusion",
    r"tear_?(?:line|film|duct)?",
    r"lacrimal(?:_fluid)?",
    r"caruncle|cartilage",
    r"face_mouth",
    r"(?:inner_)?mouth_(?:wall|bag|cavity|sock|socket|inside|interior|inner)",
    r"face_(?:hair|fuzz)|facial_hair|peach_fuzz",
)
_BROW = _words(rf"(?:face_)?(?:{_EYE})?brow(?:e?s)?(?:_(?:card|line|hair|fur)s?)?")
_LASH = re.compile(r"lash|睫|まつ")
_NATIVE_BROW = re.compile(r"眉")
_TONGUE = _words(r"tongue")
_TEETH = _words(r"teeth", r"tooth", r"gums?", r"dent(?:al|ure|ition)", r"incisor", r"molar", r"fang", r"canine_teeth")
_HAIR = r"hair(?:_?(?:band|line|cap|card|cut|style|do|piece|front|back|side|strand|tie|pin|clip|bow)s?)?"
_HAIRS = _words(_HAIR)
_NATIVE_HAIR = re.compile(r"髪|头发|頭髮")
_ON_HEAD = _words(
    _HAIR,
    r"(?:pony|pig|twin|side)_tail",
    r"braid",
    r"(?:fringe|bangs?|bun|ahoge|mohawk|afro|dreads?|wig)",
    r"(?:sun|eye|reading)?_?glass(?:es)?(?:_(?:frame|lens|lense)s?)?",
    r"goggle",
    r"spectacles?",
    r"eye_wear|eye_patch",
    r"monocle",
    r"ear_(?:ring|bud|phone|muff|stud)",
    r"head_(?:phone|band|set|wear|dress|gear|scarf|piece)",
    r"(?:helm|helmet|visor|mask|horn|antler|crown|tiara|hat|fedora|beret|turban|cap|beanie|hood|halo|veil|piercing|ribbon)",
)
_EYES = _words(
    rf"(?:face_)?{_EYE}(?:ball|iris|white|highlight|pupil|lens|shine|reflex|reflection|cornea|sclera|inner|outer|all)?s?",
    r"iris(?:es)?|irides",
    r"(?:pupil|cornea|sclera|eyeball)",
    r"conjunctiva",
)
_EYE_SKIN = _words(r"(?:upper_|lower_)?eye_(?:lid|socket|bag|let)", r"eye_(?:upper_|lower_)?lid")
"""Skin that is named after the eye."""
_NATIVE = (
    (re.compile(r"眉|睫|まつ[毛げ]|髭|ひげ|胡|[目眼]の?影"), Part.ON_SKIN),
    (re.compile(r"舌"), Part.TEETH_LOWER),
    (re.compile(r"[歯齿牙]"), Part.TEETH_UPPER),
    (re.compile(r"髪|头发|頭髮|眼鏡|眼镜|メガネ|帽"), Part.ON_HEAD),
    (re.compile(r"[目眼瞳]|虹彩|ハイライト"), Part.EYE_LEFT),
)
"""Names in Japanese and Chinese, in which many avatars are made, and which do not separate words."""
_NAMED = (
    (_ON_SKIN, Part.ON_SKIN),
    (_EYE_SKIN, None),
    (_TONGUE, Part.TEETH_LOWER),
    (_TEETH, Part.TEETH_UPPER),
    (_ON_HEAD, Part.ON_HEAD),
    (_EYES, Part.EYE_LEFT),
)
_RANKS = (Part.ON_SKIN, Part.TEETH_LOWER, Part.TEETH_UPPER, Part.EYE_LEFT, Part.ON_HEAD)
"""Parts, those with the more telling names first: brows and lashes are made of hair, corneas of glass."""
_INSIDE = _words(r"(?:face_)?mouth")
"""Names of the wall of the mouth that may also be those of the teeth and the tongue within it."""
_LOWER = re.compile(r"lower|bottom|mandib| low | jaw | bot | btm |下")
_UPPER = re.compile(r"upper|maxill| up | top |上")
_BODY = _words(
    r"(?:body|bodies|torso|foot|feet|hand|leg|arm|nail|finger|toe)",
    r"(?:cloth|clothes|clothing|outfit|wear|under_wear|garment|uniform|costume|kimono|(?:casual_|elegant_|sport_)?suit|armou?r|accessor(?:y|ies))",
    r"(?:t_|sweat_|under_)?shirt",
    r"(?:dress|pants?|trousers?|shorts|jeans|skirt|jacket|coat|vest|hoodie|sweater|sleeve|belt|scarf|collar|tie)",
    r"(?:shoe|boot|sock|glove|sneaker|heel|foot_wear)",
    r"(?:bracelet|watch|necklace)",
    r"outfit_(?:top|bottom|footwear)",
    r"(?:top|bottom)s?",
)
_NECK = re.compile(
    r" (?:neck|throat|hals|nacken|kehle|nek|cou|nuque|gorge|cuello|garganta|collo|gola|pescoço|pescoco|szyja|kark|krk|"
    r"nyak|kaula|boyun|leher|\u0448\u0435\u044f|\u0448\u0438\u044f)"
    r"(?:s|skin|mesh|geo|geometry|obj|object|mat|material|base)* |[首頸颈脖]"
)
"""Necks in the languages in which characters are made."""
_WHOLE = _words(r"(?:body|bodies)")
_NATIVE_WHOLE = re.compile(r"身体|体$")
_NATIVE_BODY = re.compile(r"身体|体$|服|衣|靴|手袋|スカート|ズボン")
_LEVEL = re.compile(r"[ _.-]?(?:(?<![A-Za-z])lod|(?<![A-Z])LOD|Lod)[ _.-]?(\d{1,2})(?!\d)")
"""The level of detail in a name: `Head_LOD1`, `head_lod1_mesh`, `LOD 1`; Blender's copies have numbers of 3 digits."""
_FACE = _words(r"(?:face|head)(?:_skin)?", r"顔|颜|臉|脸|頭|头")
_SKIN = _words(r"skin")


def named_part(names: Sequence[str]) -> Part | None:
    """Return the part that names, the most specific first, describe, or None. Teeth count as upper and eyes as left.

    A name of several parts, such as that of an object with all of them, decides only if no other does.
    """
    found = [parts_in(name) for name in names]
    certain = [parts[0] for parts in found if len(parts) == 1] or [parts[0] for parts in found if parts]
    if not certain:
        return None
    part = min(certain, key=_RANKS.index)
    if part == Part.TEETH_UPPER and any(_LOWER.search(spaced(name)) for name in names):
        return Part.TEETH_LOWER
    return part


def parts_in(name: str) -> list[Part]:
    """Return the parts that a single name describes; the tongue counts as lower teeth."""
    text, found = spaced(name), []
    for pattern, part in (*_NAMED, *_NATIVE):
        text, count = pattern.subn(" ", text)
        if count and part is not None:
            found.append(part)
    return list(dict.fromkeys(found))


def names_brow(name: str) -> bool:
    """Return whether a name is that of the brows alone."""
    return bool(_BROW.search(spaced(name)) or _NATIVE_BROW.search(name)) and not _LASH.search(spaced(name) + name)


def names_hair(names: Sequence[str]) -> bool:
    """Return whether one of the names is that of hair."""
    return any(_HAIRS.search(spaced(name)) or _NATIVE_HAIR.search(name) for name in names)


def names_upper(names: Sequence[str]) -> bool:
    """Return whether a name says that teeth are those of the upper row."""
    return any(_UPPER.search(spaced(name)) for name in names)


def names_inside(name: str) -> bool:
    """Return whether a name may be that of the wall of the mouth or of what is within it."""
    return bool(_INSIDE.search(spaced(name)))


def names_skin(name: str) -> bool:
    """Return whether a name is that of the skin of a face or head."""
    text = spaced(name)
    return bool(_FACE.search(text) or (_SKIN.search(text) and not _BODY.search(text))) and not parts_in(name)


def names_body(name: str) -> bool:
    """Return whether a name is that of a body or its clothes; a "mouth sock" is not."""
    text = spaced(name)
    return bool(_BODY.search(text) or _NATIVE_BODY.search(name)) and not (_FACE.search(text) or parts_in(name))


def names_whole_body(name: str) -> bool:
    """Return whether a name is that of a body, which may have a head, rather than of a limb or of clothes."""
    return names_body(name) and bool(_WHOLE.search(spaced(name)) or _NATIVE_WHOLE.search(name))


def names_below_face(name: str) -> bool:
    """Return whether a name is that of a neck, a limb or a garment, which may reach up behind the chin."""
    text = spaced(name)
    if parts_in(name) or _INSIDE.search(text):
        return False
    return bool(_NECK.search(text)) or (names_body(name) and not names_whole_body(name))


def names_neck(name: str) -> bool:
    """Return whether a name is that of a neck."""
    return bool(_NECK.search(spaced(name))) and not parts_in(name)


def level_of_detail(name: str) -> tuple[str, int] | None:
    """Return a name without its level of detail, and that level, 0 for the finest: `Head_LOD1` becomes `Head`, 1."""
    found = _LEVEL.search(name)
    return None if found is None else (without_number(name[: found.start()] + name[found.end() :]), int(found[1]))


def without_number(name: str) -> str:
    """Return a name without the number by which Blender tells copies apart: `Head.001` becomes `Head`."""
    return re.sub(r"\.\d{3,}$", "", name)


def spaced(name: str) -> str:
    """Return the words of a name in lower case between spaces: `EyeLeft.001` becomes ` eye left `."""
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name)
    return " " + " ".join(re.sub(r"[\W\d_]+", " ", apart.lower()).split()) + " "


@dataclass(frozen=True)
class FaceBones:
    """Names of the bones that move with a face; "" where a rig has none. Left and right are the character's own."""

    head: str = ""
    eye_right: str = ""
    eye_left: str = ""
    jaw: str = ""


def find_bones(names: Sequence[str], weights: Mapping[str, float]) -> FaceBones:
    """Find the bones of head, eyes and jaw by their names.

    Names are split into words. Case, side and the prefixes of Mixamo, VRM, 3ds Max, Rigify, Auto-Rig and MetaHuman are
    ignored. Of several candidates, the one with the fewest other words in its name is taken. If no name is of a head,
    `weights` decide: the share of the skin of the face that each bone moves.
    """
    head = _best(names, _HEADS, set()) or max(weights, key=lambda name: weights[name], default="")
    return FaceBones(
        head, _best(names, _EYE_BONES, _RIGHT), _best(names, _EYE_BONES, _LEFT), _best(names, _JAWS, set())
    )


def _best(names: Sequence[str], wanted: Sequence[set[str]], side: set[str]) -> str:
    """Return the best match among `names`: one of `wanted` with a side. "" if none matches."""
    for words in wanted:
        for name in names:
            found = _words_of(name)
            sides = found & (_LEFT | _RIGHT)
            if found - _LEFT - _RIGHT - _AFFIXES == words and (bool(sides & side) if side else not sides):
                return name
    return ""


def _words_of(name: str) -> set[str]:
    """Return the words of a name in lower case, without numbers: `J_Bip_C_Head` and `head.x` contain "head", and
    `Bip01 LEye` and `左目` have the words "l" or "left", and "eye".
    """
    for native, word in _NATIVE_BONES.items():
        name = name.replace(native, f"_{word}_")
    apart = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name)
    return {word for word in re.split(r"[^a-z\u3040-\u9fff]+", apart.lower()) if word}
