"""The mathematics of Facemime: numpy, cv2 and the standard library, never bpy.

Two frames of reference, used everywhere in this package:

image
    pixels, x right, y down; the centre of the top left pixel is (0, 0).
head
    x to the viewer's right, y down, z away from the viewer, so that a face looks along -z and, unturned, projects
    onto the image by dropping z. Right-handed. Lengths are metres for avatar heads and multiples of the mean
    outer-eye distance for the tracker's shape model.

Angles are radians and times are seconds. `blender/` alone converts to Blender's axes.
"""
