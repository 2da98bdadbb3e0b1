"""Two samples of a suite in Inspect, with a mock model that always turns left. Prints the logs
as Inspect reads them: first this one, then those that were there before."""

from inspect_ai import eval
from inspect_ai.log import list_eval_logs, read_eval_log
from inspect_ai.model import ModelOutput, ModelUsage, get_model

from memtransfer.inspect_tasks import suite


def reply(*_request):
    usage = ModelUsage(input_tokens=900, output_tokens=3, total_tokens=903)
    return ModelOutput(model="mockllm", usage=usage, choices=ModelOutput.from_content("", "Turn left.").choices)


# Of the hundred cases the suite selects half.
assert len(suite("quick").dataset) == 50 * 12

earlier = list_eval_logs()
model = get_model("mockllm/model", custom_outputs=reply)
(log,) = eval("memtransfer/rq1", model, limit=2, epochs=1, display="none", task_args={"out": "runs"})
assert log.status == "success", log.error
for log in [log.location, *earlier]:
    print(read_eval_log(log).model_dump_json())
