/* Flamenco job type: the clips of a folder or a list, one task each, then a report of all.
 * Goes into the `scripts` folder of the Flamenco manager. The workers need `facemime` on their path, and must see the
 * clips, the head and the output folder under the same paths. Started again, what is done is left as it is. */
const JOB_TYPE = {
    label: "Facemime",
    description: "Move a head by the faces of many video clips",
    settings: [
        { key: "clips", type: "string", required: true, description: "Folder of clips, or a text with a path a line" },
        { key: "count", type: "int32", required: true, description: "How many clips there are" },
        { key: "output", type: "string", subtype: "dir_path", required: true, description: "Folder for what comes out" },
        { key: "head", type: "string", default: "", description: "FILE.blend:OBJECT; the built-in head if empty" },
        { key: "face", type: "string", default: "",
          description: "Of several people left, right, or the one at pixels X,Y; the largest if empty" },
        { key: "pose", type: "string", choices: ["rotation", "full", "none"], default: "rotation",
          description: "How much of the head's movement is followed" },
        { key: "keys", type: "string", choices: ["new", "named", "mapped", "cache", "alembic"], default: "new",
          description: "New shape keys, the head's own, its own by a table, or every vertex in a file" },
        { key: "map", type: "string", default: "", description: "Table of keys for 'mapped'; else what fits best" },
        { key: "smooth", type: "bool", default: false, description: "Hold still what does not move" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    const options = ["-o", settings.output, "--head", settings.head || "", "--face", settings.face || "",
        "--pose", settings.pose || "rotation", "--keys", settings.keys || "new", "--map", settings.map || ""];
    if (settings.smooth) options.push("--smooth");

    const report = facemime("report", ["batch", settings.clips].concat(options));
    for (let number = 1; number <= settings.count; number++) {
        const task = facemime("clip-" + number, ["clip", settings.clips, "--number", String(number)].concat(options));
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
