// A job type for Flamenco 3: put this file into the folder "scripts" beside the manager. Jobs of this type are made by `svrgs farm export`.

const JOB_TYPE = {
  label: "SVR-GS: prune splats",
  settings: [
    { key: "job_folder", type: "string", subtype: "dir_path", required: true, description: "The folder that svrgs farm export made" },
    { key: "captures", type: "string", subtype: "dir_path", required: true, description: "The folder of the captures" },
    { key: "last_task", type: "int32", required: true, description: "Number of the last task; the first one is 0" },
    { key: "tasks_per_chunk", type: "int32", default: 1, description: "Tasks that a worker does in one go" },
    { key: "svrgs", type: "string", default: "svrgs", visible: "submission", description: "The command on the workers: svrgs, or a path to it" },
  ],
};

function compileJob(job) {
  const settings = job.settings;
  const size = Math.max(1, settings.tasks_per_chunk);
  const report = author.Task("report", "misc");
  report.addCommand(command(settings, ["farm", "report", settings.job_folder]));
  for (let first = 0; first <= settings.last_task; first += size) {
    const last = Math.min(first + size - 1, settings.last_task);
    const numbers = first === last ? String(first) : first + "-" + last;
    const task = author.Task("prune " + numbers, "misc");
    task.addCommand(command(settings, ["farm", "run", settings.job_folder, "--root", settings.captures, "--tasks", numbers]));
    report.addDependency(task);
    job.addTask(task);
  }
  job.addTask(report);
}

function command(settings, words) {
  return author.Command("exec", { exe: settings.svrgs, args: words });
}
