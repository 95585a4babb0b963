"""A plugin of mypy for what Blender does at run time, and its stubs cannot say.

- A property that is declared by a call, `rate: FloatProperty(...)`, has the type of its value.
- A class decorated with `with_settings` has a property for each setting.
- Blender's classes have the properties that `POINTERS` adds to them.
- The stubs are generated from Blender's documentation. What is wrong there is corrected here: what it always has is not
  optional, a few attributes and results are missing.
"""

import ast
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

from mypy.build import PRI_LOW
from mypy.checker import TypeChecker
from mypy.maptype import map_instance_to_supertype
from mypy.nodes import ARG_POS, Argument, AssignmentStmt, CallExpr, MypyFile, NameExpr, RefExpr, TypeInfo, Var
from mypy.plugin import (
    AttributeContext,
    ClassDefContext,
    FunctionSigContext,
    MethodSigContext,
    Plugin,
    SemanticAnalyzerPluginInterface,
)
from mypy.plugins.common import add_attribute_to_class, add_method_to_class
from mypy.types import (
    AnyType,
    FunctionLike,
    Instance,
    LiteralType,
    NoneType,
    Type,
    TypeOfAny,
    UnboundType,
    UnionType,
    get_proper_type,
)

_PACKAGE = "facemime."
_VALUES = {
    "BoolProperty": "builtins.bool",
    "IntProperty": "builtins.int",
    "FloatProperty": "builtins.float",
    "StringProperty": "builtins.str",
}
_VECTORS = {
    name.replace("Property", "VectorProperty"): kind for name, kind in _VALUES.items() if name != "StringProperty"
}
_POINTERS = {
    "bpy.types.Scene.facemime": "facemime.settings.properties.FacemimeSettings",
    "bpy.types.Scene.facemime_steps": "facemime.settings.panel_properties.FacemimeSteps",
    "bpy.types.Scene.facemime_takes": "facemime.settings.takes_properties.FacemimeTakes",
    "bpy.types.WindowManager.facemime": "facemime.settings.panel_properties.FacemimeMemory",
    "bpy.types.Object.facemime": "facemime.settings.properties.FacemimeHead",
}
_KNOW_POINTERS = tuple(f"{_PACKAGE}{name}." for name in ("settings", "sessions", "operators", "ui", "cli"))
_ALWAYS_THERE = {
    "bpy.types.Context.collection",
    "bpy.types.Context.preferences",
    "bpy.types.Context.scene",
    "bpy.types.Context.tool_settings",
    "bpy.types.Context.view_layer",
    "bpy.types.Context.window_manager",
    "bpy.types.Context.workspace",
    "bpy.types.Depsgraph.view_layer",
    "bpy.types.Header.layout",
    "bpy.types.Menu.layout",
    "bpy.types.NodeSocket.links",
    "bpy.types.Operator.layout",
    "bpy.types.Panel.layout",
    "bpy.types.RenderSettings.ffmpeg",
    "bpy.types.Scene.display",
    "bpy.types.Scene.view_settings",
    "bpy.types.SceneDisplay.shading",
    "bpy.types.bpy_struct.id_data",
}
_LACKING = {
    "bpy.types.ID.animation_data": "AnimData",
    "bpy.types.WindowManager.facemime_picked": "Object",
    "bpy.types.Attribute.data": "",
    "bpy.types.NodeSocket.default_value": "",
}
"""Attributes that only classes derived from these have, or that are added to them; "" if their type differs."""
_RETURNS = {
    **{f"bpy.app.translations.pgettext_{kind}": "builtins.str" for kind in ("data", "iface", "rpt", "tip")},
    "bpy.app.is_job_running": "builtins.bool",
    "bpy.utils.register_cli_command": "builtins.object",
}
_SCALARS = {"builtins.bool", "builtins.int", "builtins.float", "builtins.str"}


class BlenderTypes(Plugin):
    """See the module."""

    def get_additional_deps(self, file: MypyFile) -> list[tuple[int, str, int]]:
        """Have the classes of `POINTERS` analysed before the modules that use them."""
        modules = sorted({name.rpartition(".")[0] for name in _POINTERS.values()} - {file.fullname})
        return [(PRI_LOW, module, -1) for module in modules] if file.fullname.startswith(_KNOW_POINTERS) else []

    def get_customize_class_mro_hook(self, fullname: str) -> Callable[[ClassDefContext], None] | None:
        """Declare properties before the body of a class is analysed."""
        if fullname.startswith(_PACKAGE):
            return _declare_properties
        if fullname == "bpy.types.bpy_struct":
            return _add_contains
        return _add_lacking if any(name.rpartition(".")[0] == fullname for name in (*_POINTERS, *_LACKING)) else None

    def get_class_decorator_hook_2(self, fullname: str) -> Callable[[ClassDefContext], bool] | None:
        """Declare a property for each setting."""
        return _declare_settings if fullname == "facemime.settings.rna.with_settings" else None

    def get_attribute_hook(self, fullname: str) -> Callable[[AttributeContext], Type] | None:
        """Correct the type of an attribute of Blender's."""
        if fullname in _POINTERS:
            return lambda context: _group(context, *_POINTERS[fullname].rsplit(".", 1))
        if fullname in _ALWAYS_THERE:
            return lambda context: _without_none(context.default_attr_type)
        if _LACKING.get(fullname):
            return lambda context: UnionType([_group(context, "bpy.types", _LACKING[fullname]), NoneType()])
        return _scalar_is_there if fullname.startswith("bpy.types.") else None

    def get_function_signature_hook(self, fullname: str) -> Callable[[FunctionSigContext], FunctionLike] | None:
        """Let functions return something, although the stubs say that they do not."""
        if fullname in _RETURNS:
            return lambda context: _returning(context, context.api.named_generic_type(_RETURNS[fullname], []))
        if fullname.startswith("bpy.props."):
            return lambda context: _returning(context, AnyType(TypeOfAny.special_form))
        return None

    def get_method_signature_hook(self, fullname: str) -> Callable[[MethodSigContext], FunctionLike] | None:
        """Let collections return their elements."""
        return _got if fullname.startswith("bpy.types.") and fullname.endswith(".get") else None


def _declare_properties(context: ClassDefContext) -> None:
    calls = _property_calls(_path(context.api))
    for statement in context.cls.defs.body:
        call = calls.get(statement.line) if isinstance(statement, AssignmentStmt) else None
        if isinstance(statement, AssignmentStmt) and call and (kind := _value_type(call, context.api)):
            statement.type = statement.unanalyzed_type = kind


def _path(api: SemanticAnalyzerPluginInterface) -> str:
    return api.modules[api.cur_mod_id].path


@cache
def _property_calls(path: str) -> dict[int, ast.Call]:
    """Return the calls that are annotations, or to which these refer by name, by line.

    mypy drops the arguments of calls in annotations when it parses a file.
    """
    module = ast.parse(Path(path).read_bytes())
    shared = {ast.unparse(node.targets[0]): node.value for node in module.body if isinstance(node, ast.Assign)}
    declared = [node for node in ast.walk(module) if isinstance(node, ast.AnnAssign)]
    found = {node.lineno: shared.get(ast.unparse(node.annotation), node.annotation) for node in declared}
    return {line: call for line, call in found.items() if isinstance(call, ast.Call)}


def _value_type(call: ast.Call, api: SemanticAnalyzerPluginInterface) -> Type | None:
    name = ast.unparse(call.func).rpartition(".")[2]
    arguments = {keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords}
    if name in _VALUES:
        return api.named_type(_VALUES[name])
    if name == "EnumProperty":
        text = api.named_type("builtins.str")
        return api.named_type("builtins.set", [text]) if "ENUM_FLAG" in arguments.get("options", "") else text
    if name == "PointerProperty":
        group = UnboundType(arguments["type"])
        return UnionType([group, NoneType()]) if arguments["type"].startswith("bpy.types.") else group
    if name == "CollectionProperty":
        return UnboundType("bpy.types.bpy_prop_collection_idprop", [UnboundType(arguments["type"])])
    if name in _VECTORS:
        return UnboundType("bpy.types.bpy_prop_array", [api.named_type(_VECTORS[name])])
    return None


def _add_contains(context: ClassDefContext) -> None:
    key = context.api.named_type("builtins.str")
    argument = Argument(Var("key", key), key, None, ARG_POS)
    add_method_to_class(context.api, context.cls, "__contains__", [argument], context.api.named_type("builtins.bool"))


def _add_lacking(context: ClassDefContext) -> None:
    for fullname in (*_POINTERS, *_LACKING):
        owner, _, name = fullname.rpartition(".")
        if owner == context.cls.fullname and name not in context.cls.info.names:
            add_attribute_to_class(context.api, context.cls, name, AnyType(TypeOfAny.special_form))


def _group(context: AttributeContext, module: str, name: str) -> Type:
    assert isinstance(context.api, TypeChecker)
    group = context.api.modules[module].names[name].node
    assert isinstance(group, TypeInfo)
    return Instance(group, [])


def _returning(context: FunctionSigContext, kind: Type) -> FunctionLike:
    return context.default_signature.copy_modified(ret_type=kind)


def _got(context: MethodSigContext) -> FunctionLike:
    """Return the signature of `get` of a collection, which returns an element, or the default."""
    owner = get_proper_type(context.type)
    assert isinstance(owner, Instance)
    collection = next((info for info in owner.type.mro if info.fullname == "bpy.types.bpy_prop_collection"), None)
    if collection is None:
        return context.default_signature
    element = map_instance_to_supertype(owner, collection).args[0]
    signature = context.default_signature
    return signature.copy_modified(ret_type=UnionType.make_union([element, signature.ret_type]))


def _declare_settings(context: ClassDefContext) -> bool:
    assert isinstance(context.reason, CallExpr)
    for argument in context.reason.args:
        for name, setting in _settings(argument):
            if name not in context.cls.info.names:
                add_attribute_to_class(context.api, context.cls, name, setting)
    return True


def _settings(group: object) -> Iterator[tuple[str, Type]]:
    """Yield name and type of the fields of a dataclass, or of the instance that a name stands for, that are settings.

    These are the scalars and choices among texts; the others are values that are not edited.
    """
    node = group.node if isinstance(group, RefExpr) else None
    if isinstance(group, NameExpr) and not isinstance(node, TypeInfo):
        declared = get_proper_type(getattr(node, "type", None))
        node = declared.type if isinstance(declared, Instance) else None
    if isinstance(node, TypeInfo):
        for owner in reversed(node.mro):
            for name, symbol in owner.names.items():
                kind = get_proper_type(symbol.type)
                choices = map(get_proper_type, kind.items) if isinstance(kind, UnionType) else [kind]
                if all(isinstance(one, LiteralType) for one in choices) or _is_scalar(kind):
                    assert kind is not None
                    yield name, kind


def _is_scalar(kind: Type | None) -> bool:
    return isinstance(kind, Instance) and kind.type.fullname in _SCALARS


def _without_none(kind: Type) -> Type:
    kind = get_proper_type(kind)
    if isinstance(kind, UnionType):
        return UnionType.make_union([item for item in kind.items if not isinstance(get_proper_type(item), NoneType)])
    return kind


def _scalar_is_there(context: AttributeContext) -> Type:
    """Numbers and texts are never None; the stubs mean by it that they have a default."""
    bare = get_proper_type(_without_none(context.default_attr_type))
    return bare if _is_scalar(bare) else context.default_attr_type


def plugin(version: str) -> type[Plugin]:
    """Return the plugin."""
    return BlenderTypes
