"""Everything that Facemime computes, without Blender.

Two frames of reference are used throughout:

image
    pixels, x right, y down; the centre of the top left pixel is (0, 0).
head
    x to the viewer's right, y down, z away from the viewer; right-handed. A face looks along -z and, without rotation,
    is projected by dropping z. Lengths are metres for avatars and outer-eye distances for the shape model.

Angles are in radians and times in seconds. Only `blender/` converts to Blender's axes.
"""

if __name__ == "facemime.core":  # the library; nothing else imports the extension's modules
    from .earlier_names import MODULES, PACKAGES, install

    install(__name__, MODULES, PACKAGES)
