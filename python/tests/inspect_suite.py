"""Two samples of a suite in Inspect, with a mock model that always turns left. Prints the log
as Inspect reads it."""

from inspect_ai import eval
from inspect_ai.log import read_eval_log
from inspect_ai.model import ModelOutput, ModelUsage, get_model


def reply(*_request):
    usage = ModelUsage(input_tokens=900, output_tokens=3, total_tokens=903)
    return ModelOutput(model="mockllm", usage=usage, choices=ModelOutput.from_content("", "Turn left.").choices)


model = get_model("mockllm/model", custom_outputs=reply)
(log,) = eval("memtransfer/rq1", model, limit=2, epochs=1, display="none", task_args={"out": "runs"})
assert log.status == "success", log.error
print(read_eval_log(log.location).model_dump_json())
