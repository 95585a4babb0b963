/* Flamenco job type: tasks that share the clips of a folder or a list, followed by a report on all clips.
 * Copy this file to the `scripts` folder of the Flamenco manager. The workers need `facemime` on their path, and must
 * have the clips, the head and the output folder under the same paths. If the job is run again, clips that are done are
 * skipped. */
const JOB_TYPE = {
    label: "Facemime",
    description: "Drive a head with the faces in many video clips",
    settings: [
        { key: "clips", type: "string", required: true,
          description: "Folder of clips, or a text file with one path per line" },
        { key: "tasks", type: "int32", default: 100, propargs: { min: 1, max: 10000 },
          description: "Number of tasks, each with its share of the clips; more workers than tasks are idle" },
        { key: "output", type: "string", subtype: "dir_path", required: true, description: "Folder for the results" },
        // Options, written by tools/farm.py
        { key: "face", type: "string", default: "",
          description: "face to track if several are in view: the leftmost, the rightmost, or the nearest to a pixel of the first frame (the largest)" },
        { key: "detector", type: "string", choices: ["network", "cascades"], default: "network",
          description: "how faces are found on the first frame and after tracking was lost (network)" },
        { key: "tracker_model", type: "string", default: "",
          description: "file of a model of FaceTracker, which the paper uses, from the next start on; empty for Facemime's own" },
        { key: "head", type: "string", default: "",
          description: "your own head, as for bind (the built-in head)" },
        { key: "points", type: "string", default: "",
          description: "control points, from select" },
        { key: "style", type: "string", default: "",
          description: "examples by which the head is corrected, from Save Style" },
        { key: "pose", type: "string", choices: ["none", "rotation", "full"], default: "rotation",
          description: "how much of the head's pose to follow (rotation)" },
        { key: "smoothing", type: "float", default: 1.0,
          description: "jitter smoothing: 0 is off, values above 1 add lag (1)" },
        { key: "mode", type: "string", choices: ["3d", "planar"], default: "3d",
          description: "where the depth of the motion comes from (3d)" },
        { key: "kernel", type: "string", choices: ["informed", "multiscale", "gaussian", "wendland", "biharmonic"], default: "informed",
          description: "how the skin between the landmarks follows their motion (informed)" },
        { key: "strength_upper", type: "float", default: 1.0,
          description: "strength of the motion of the brows and upper eyelids (1)" },
        { key: "strength_middle", type: "float", default: 1.0,
          description: "strength of the motion of the lower eyelids, cheeks and upper lip (1)" },
        { key: "strength_lower", type: "float", default: 1.0,
          description: "strength of the motion of the lower lip and chin (1)" },
        { key: "mirror", type: "bool", default: false,
          description: "move the head like the performer's mirror image" },
        { key: "only_landmarks", type: "bool", default: false,
          description: "ignore actions that no landmark shows: the tongue, puffed cheeks, pressed lips and a wrinkled nose" },
        { key: "borders", type: "string", choices: ["soft", "sharp"], default: "soft",
          description: "how neighbouring regions meet (soft)" },
        { key: "exact", type: "bool", default: false,
          description: "meet the landmarks exactly, as in the paper; the skin between them is less smooth" },
        { key: "incremental", type: "bool", default: false,
          description: "fit each frame to the previous one, as in the paper; slower, and the face does not fully return to rest" },
        { key: "contact", type: "bool", default: true,
          description: "let the eyelids slide over the eyeballs; has no effect if the depth is planar" },
        { key: "rotation_strength", type: "float", default: 1.0,
          description: "head rotation relative to the performer's (1)" },
        { key: "rotation_limit", type: "float", default: 180.0,
          description: "largest rotation of the head from rest (180)" },
        { key: "location_strength", type: "float", default: 1.0,
          description: "head movement relative to the performer's (1)" },
        { key: "location_limit", type: "float", default: 10.0,
          description: "largest movement of the head from rest, in eye distances (10)" },
        { key: "eyes_strength", type: "float", default: 1.0,
          description: "eye rotation relative to the performer's (1)" },
        { key: "eyes_limit", type: "float", default: 30.0,
          description: "largest rotation of the eyes from rest (30)" },
        { key: "keys", type: "string", choices: ["automatic", "new", "named", "mapped", "controls", "cache", "alembic"], default: "automatic",
          description: "what the take is baked to (automatic)" },
        { key: "max_keys", type: "int32", default: 64,
          description: "maximum number of new shape keys (64)" },
        { key: "residual", type: "bool", default: true,
          description: "add shape keys for what the existing ones cannot show, in a group of curves that can be muted" },
        { key: "positive", type: "bool", default: false,
          description: "split new shape keys that move both ways in two, as many programs cut off values below 0" },
        { key: "whole_frames", type: "bool", default: true,
          description: "put keyframes on whole frames of the scene, as few as Detail needs; otherwise at the times of the take" },
        { key: "clean", type: "float", default: 0.5,
          description: "error that fewer keyframes may cause, relative to the eye distance; 0 gives every frame a keyframe (0.5)" },
        { key: "nla", type: "bool", default: false,
          description: "put the animation on an NLA track instead of the active action" },
        { key: "keep_animation", type: "bool", default: false,
          description: "add the take to other animation of the same shape keys and bones, instead of muting it" },
        { key: "start", type: "string", choices: ["first", "current", "scene"], default: "first",
          description: "frame of the scene at which the take starts (first)" },
        { key: "fit_range", type: "bool", default: false,
          description: "set the scene's frame range to that of the take even if the scene has its own range or other animation" },
        { key: "map", type: "string", default: "",
          description: "key mapping for --keys mapped (the preset that matches the head best)" },
        // End of options
    ],
};

const OPTIONS = [
    // Options, written by tools/farm.py
    "face",
    "detector",
    "tracker-model",
    "head",
    "points",
    "style",
    "pose",
    "smoothing",
    "mode",
    "kernel",
    "strength-upper",
    "strength-middle",
    "strength-lower",
    "mirror",
    "only-landmarks",
    "borders",
    "exact",
    "incremental",
    "contact",
    "rotation-strength",
    "rotation-limit",
    "location-strength",
    "location-limit",
    "eyes-strength",
    "eyes-limit",
    "keys",
    "max-keys",
    "residual",
    "positive",
    "whole-frames",
    "clean",
    "nla",
    "keep-animation",
    "start",
    "fit-range",
    "map",
    // End of options
];

function compileJob(job) {
    const settings = job.settings;
    const options = ["-o", settings.output];
    for (const name of OPTIONS) {
        const value = settings[name.split("-").join("_")];
        if (value === true) options.push("--" + name);
        else if (value === false) options.push("--no-" + name);
        else if (value !== undefined && value !== "") options.push("--" + name, String(value));
    }
    const report = facemime("report", ["batch", settings.clips].concat(options));
    for (let number = 1; number <= settings.tasks; number++) {
        const share = number + "/" + settings.tasks;
        const task = facemime("clips " + share, ["clip", settings.clips, "--share", share].concat(options));
        report.addDependency(task);
        job.addTask(task);
    }
    job.addTask(report);
}

function facemime(name, args) {
    const task = author.Task(name, "misc");
    task.addCommand(author.Command("exec", { exe: "facemime", args: args }));
    return task;
}
