"""Settings that belong to the scene."""

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, PointerProperty

from .puppet import PuppetSettings


class FacemimeSettings(bpy.types.PropertyGroup):
    """How a performance moves the head."""

    mode: EnumProperty(
        name="Depth",
        description="Where the depth of a motion comes from",
        items=(
            ("3d", "3D", "Depth from the tracker's 3-D face"),
            ("planar", "Planar", "Every vertex keeps its depth"),
        ),
        default="3d",
    )
    kernel: EnumProperty(
        name="Skin",
        description="How the skin between the landmarks follows them",
        items=(
            ("informed", "Informed", "By distance and by what moves together in known expressions"),
            ("multiscale", "Multiscale", "By distance, near and far"),
            ("gaussian", "Gaussian", "By one Gaussian of distance a region: the paper's"),
            ("wendland", "Wendland", "By a smooth function of distance that ends"),
            ("biharmonic", "Biharmonic", "By distance as a thin plate would"),
        ),
        default="informed",
    )
    strength_upper: FloatProperty(name="Brows and Upper Lids", default=1.0, min=0.0, soft_max=2.0, max=5.0)
    strength_middle: FloatProperty(name="Cheeks and Upper Lip", default=1.0, min=0.0, soft_max=2.0, max=5.0)
    strength_lower: FloatProperty(name="Lower Lip and Chin", default=1.0, min=0.0, soft_max=2.0, max=5.0)
    find_neutral: BoolProperty(
        name="Find Neutral",
        description="Find the second in which the performer's face is at rest; else say where it starts",
        default=True,
    )
    neutral: FloatProperty(
        name="Neutral At", description="Where the performer's neutral second starts", subtype="TIME_ABSOLUTE", min=0.0
    )
    rotation: BoolProperty(name="Head Rotation", description="Turn the head as the performer does", default=True)
    translation: BoolProperty(name="Head Location", description="Move the head as the performer does", default=False)
    pose_object: PointerProperty(
        name="Pose Object",
        description="Takes the head's pose instead of the head itself: an empty, say",
        type=bpy.types.Object,
    )


def puppet_settings(settings: FacemimeSettings) -> PuppetSettings:
    """The scene's settings as plain values.

    Not a method: Blender 4.2 ends in a crash after an extension was removed whose property group had one.
    """
    return PuppetSettings(
        mode=settings.mode,
        kernel=settings.kernel,
        strength=(settings.strength_upper, settings.strength_middle, settings.strength_lower),
        neutral=None if settings.find_neutral else settings.neutral,
        rotation=settings.rotation,
        translation=settings.translation,
    )


def register() -> None:
    """Add the settings to every scene."""
    bpy.utils.register_class(FacemimeSettings)
    bpy.types.Scene.facemime = PointerProperty(type=FacemimeSettings)


def unregister() -> None:
    """Take the settings away."""
    del bpy.types.Scene.facemime
    bpy.utils.unregister_class(FacemimeSettings)
