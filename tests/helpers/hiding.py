"""Ways in which Blender hides objects."""

import bpy


def in_collection(objects, parent=None):
    """A collection with these objects and nothing else that has them."""
    collection = bpy.data.collections.new("Character")
    (parent or bpy.context.scene.collection).children.link(collection)
    for obj in objects:
        for other in obj.users_collection:
            other.objects.unlink(obj)
        collection.objects.link(obj)
    bpy.context.view_layer.update()
    return collection


def layer_of(collection):
    """The collection in the view layer, at any depth."""
    places = [bpy.context.view_layer.layer_collection]
    while places:
        place = places.pop()
        if place.collection == collection:
            return place
        places += place.children
    raise AssertionError(collection.name)


def _object(name):
    def hide(objects):
        for obj in objects:
            setattr(obj, name, True)

    return hide


def _eye(objects):
    for obj in objects:
        obj.hide_set(True)


def _collection(name):
    def hide(objects):
        setattr(in_collection(objects), name, True)

    return hide


def _layer(name):
    def hide(objects):
        setattr(layer_of(in_collection(objects)), name, True)

    return hide


def _excluded_parent(objects):
    outer = bpy.data.collections.new("Outer")
    bpy.context.scene.collection.children.link(outer)
    in_collection(objects, outer)
    layer_of(outer).exclude = True


HIDING = {
    "object unselectable": _object("hide_select"),
    "object disabled": _object("hide_viewport"),
    "object hidden": _eye,
    "collection unselectable": _collection("hide_select"),
    "collection disabled": _collection("hide_viewport"),
    "collection hidden": _layer("hide_viewport"),
    "collection excluded": _layer("exclude"),
    "parent excluded": _excluded_parent,
}
