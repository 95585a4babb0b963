"""Recordings as other programs write them: Audio2Face, Face Cap, OpenFace and Unity."""

from __future__ import annotations

import json

_NAMES = (
    "browInnerUp browDown_L browDown_R browOuterUp_L browOuterUp_R eyeLookUp_L eyeLookUp_R eyeLookDown_L eyeLookDown_R "
    "eyeLookIn_L eyeLookIn_R eyeLookOut_L eyeLookOut_R eyeBlink_L eyeBlink_R eyeSquint_L eyeSquint_R eyeWide_L "
    "eyeWide_R cheekPuff cheekSquint_L cheekSquint_R noseSneer_L noseSneer_R jawOpen jawForward jawLeft jawRight "
    "mouthFunnel mouthPucker mouthLeft mouthRight mouthRollUpper mouthRollLower mouthShrugUpper mouthShrugLower "
    "mouthClose mouthSmile_L mouthSmile_R mouthFrown_L mouthFrown_R mouthDimple_L mouthDimple_R mouthUpperUp_L "
    "mouthUpperUp_R mouthLowerDown_L mouthLowerDown_R mouthPress_L mouthPress_R mouthStretch_L mouthStretch_R tongueOut"
)
FACE_CAP_NAMES = _NAMES.split()


def audio2face(names, rows, **more):
    return json.dumps({"numPoses": len(names), "numFrames": len(rows), "facsNames": names, "weightMat": rows} | more)


def face_cap(frames):
    lines = ["info,Face Cap,1.6,mm", "bs," + ",".join(FACE_CAP_NAMES)]
    for milliseconds, turn, values in frames:
        cells = [milliseconds, 0.01, 0.02, -0.4, *turn, 1.0, 2.0, 1.0, 2.0]
        lines.append(",".join(["k", *map(str, cells), *(str(values.get(name, 0)) for name in FACE_CAP_NAMES)]))
    return "\n".join(lines) + "\n"


UNITS = ["AU01", "AU02", "AU04", "AU05", "AU06", "AU07", "AU09", "AU10", "AU12", "AU14", "AU15", "AU17", "AU20"]
UNITS += ["AU23", "AU25", "AU26", "AU45"]


def openface(rows):
    head = ["frame", "face_id", "timestamp", "confidence", "success", "gaze_angle_x", "gaze_angle_y"]
    head += ["pose_Rx", "pose_Ry", "pose_Rz", *(f"{unit}_r" for unit in UNITS), *(f"{unit}_c" for unit in UNITS)]
    lines = [", ".join(head)]
    for i, row in enumerate(rows):
        values = {"frame": i + 1, "timestamp": i * 0.04, "success": 1, "confidence": 0.98} | row
        lines.append(", ".join(f"{values.get(name, 0):g}" for name in head))
    return "\n".join(lines) + "\n"


def unity(curves, rate=30):
    lines = ["%YAML 1.1", "%TAG !u! tag:unity3d.com,2011:", "--- !u!74 &7400000", "AnimationClip:", "  m_Name: Talk"]
    lines += ["  serializedVersion: 7", "  m_PositionCurves: []", "  m_FloatCurves:"]
    for path, name, keys in curves:
        lines += ["  - serializedVersion: 2", "    curve:", "      serializedVersion: 2", "      m_Curve:"]
        for time, value, before, after in keys:
            lines += ["      - serializedVersion: 3", f"        time: {time}", f"        value: {value}"]
            lines += [f"        inSlope: {before}", f"        outSlope: {after}", "        tangentMode: 136"]
            lines += ["        weightedMode: 0", "        inWeight: 0.33333334", "        outWeight: 0.33333334"]
        lines += ["      m_PreInfinity: 2", "      m_PostInfinity: 2", "      m_RotationOrder: 4"]
        lines += [
            f"    attribute: {name}",
            f"    path: {path}",
            "    classID: 137",
            "    script: {fileID: 0}",
            "    flags: 16",
        ]
    return "\n".join([*lines, "  m_PPtrCurves: []", f"  m_SampleRate: {rate}", "  m_WrapMode: 0", ""])
