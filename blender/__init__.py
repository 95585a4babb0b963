"""Everything that is done in Blender, for windows and the command alike."""

if __name__ == "facemime.blender":  # the library; nothing else imports the extension's modules
    from ..core.earlier_names import install

    install(
        __name__,
        {
            "animation.aside": "animation.resting",
            "animation.bake": "animation.placed",
            "animation.bake_controls": "controls.solving",
            "animation.bake_keys": "animation.key_drivers animation.standing",
            "animation.bake_report": "animation.plan",
            "animation.conflicts": "animation.overruled animation.underneath",
            "animation.exporting": "animation.bake_cache animation.gltf media.saving",
            "animation.live_keys": "animation.live_values",
            "animation.sampling": "animation.animated_keys",
            "contexts": "undo",
            "controls.checks": "controls.loose controls.speed",
            "controls.display": "controls.arrows controls.sheet",
            "fcurves": "shared_actions tracks",
            "head_properties": "control_properties style_properties",
            "heads.keyed": "heads.vrm",
            "heads.new_heads": "heads.built_in",
            "heads.openings": "heads.eyes heads.lips",
            "heads.placing": "heads.binding_undo heads.landmark_places",
            "reference": "media.sound",
            "view_layers": "collections placement",
        },
        packages={"media": ""},
    )
