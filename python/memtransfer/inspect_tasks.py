"""Suites as tasks of Inspect: the model is Inspect's, the harness ours.

    inspect eval memtransfer/rq1 --model openai/gpt-4o --sample-id "t03-01.*"

A sample is a case under a condition. It is run by a `memtransfer run` of its own, whose requests go to the model that
Inspect evaluates, as the prompt of `--policy openai`. Needs `pip install 'memtransfer[inspect]'`. The
guide is `docs/inspect.md` of the project.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
import uuid
from collections.abc import Sequence
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from memtransfer import _native
from memtransfer._extras import missing
from memtransfer._program import dying_with_this_process
from memtransfer.codes import Outcome
from memtransfer.errors import MemTransferError
from memtransfer.policy import Policy
from memtransfer.programs import program
from memtransfer.prompt import IMAGE_BUDGET, SETTINGS, VERSION, Prompt, data_url, read_answer, render
from memtransfer.request import Answer, Decision, Failed, Request, Usage
from memtransfer.serving import serve

try:
    import anyio
    import anyio.abc
    import anyio.from_thread
    import anyio.to_thread
    from inspect_ai import Task, task
    from inspect_ai.dataset import Sample
    from inspect_ai.event import SampleLimitEvent
    from inspect_ai.log import transcript
    from inspect_ai.model import (
        ChatMessage,
        ChatMessageSystem,
        ChatMessageUser,
        Content,
        ContentImage,
        ContentText,
        GenerateConfig,
        Model,
        ModelOutput,
        get_model,
    )
    from inspect_ai.scorer import Score, Scorer, Target, grouped, mean, scorer, stderr
    from inspect_ai.solver import Generate, Solver, TaskState, solver
except ModuleNotFoundError as error:
    raise missing(error, "inspect") from None

_FLAGS = ("memory", "starts", "routes", "demos", "segment", "hint", "mismatch", "window")
"""The flags of `memtransfer run` that make a condition."""

_PATIENCE_SECONDS = 86400
"""How long a run waits for an answer. Inspect has limits of its own."""


@task
def quick(image_budget: int = IMAGE_BUDGET, out: str | None = None) -> Task:
    """Every memory, from an original and from a new start."""
    return suite("quick", image_budget, out)


@task
def rq1(image_budget: int = IMAGE_BUDGET, out: str | None = None) -> Task:
    """RQ1, a new starting pose."""
    return suite("rq1", image_budget, out)


@task
def rq2(image_budget: int = IMAGE_BUDGET, out: str | None = None) -> Task:
    """RQ2, outdated memory."""
    return suite("rq2", image_budget, out)


@task
def rq3(image_budget: int = IMAGE_BUDGET, out: str | None = None) -> Task:
    """RQ3, demonstrations of other tasks."""
    return suite("rq3", image_budget, out)


@task
def suite(name: str, image_budget: int = IMAGE_BUDGET, out: str | None = None) -> Task:
    """Any suite.

    Args:
        name: The name of a shipped suite, or a suite file.
        image_budget: The maximum number of images in a request.
        out: The folder that keeps the runs; without it they are removed.
    """
    conditions = _listed("conditions", "--suite", name)
    cases = _listed("cases", "--suite", name)
    samples = [_sample(case, condition) for case in cases for condition in conditions]
    return Task(
        dataset=samples,
        solver=episode(name, image_budget, out),
        scorer=episode_scorer(),
        config=GenerateConfig(**SETTINGS),
        epochs=max(condition["runs"] for condition in conditions),
        name=Path(name).stem,
        metadata={"suite": name, "prompt": VERSION},
    )


def _sample(case: dict[str, Any], condition: dict[str, Any]) -> Sample:
    flags = {name: str(condition[name]) for name in _FLAGS if condition[name] != "none"}
    parts = [condition[name] for name in ("memory", "starts", "routes", "demos")]
    standard = {"segment": "actions", "hint": "on", "window": 6}
    parts += [f"{name}-{condition[name]}" for name in standard if condition[name] != standard[name]]
    parts += [condition["mismatch"]] if condition["mismatch"] != "none" else []
    return Sample(
        id=".".join([case["case"], *parts]),
        input=case["instruction"],
        metadata={"case": case["case"], "condition": "/".join(parts), "flags": flags},
    )


@solver
def episode(suite: str, image_budget: int = IMAGE_BUDGET, out: str | None = None) -> Solver:
    """Runs the episode of a sample."""

    async def solve(state: TaskState, generate: Generate) -> TaskState:
        name = f"memtransfer-inspect-{uuid.uuid4().hex}" if out is None else f"{state.sample_id}.{state.epoch}"
        run = Path(out or tempfile.gettempdir(), name).absolute()
        command = [str(program()), "run", "--suite", suite, "--cases", state.metadata["case"]]
        for flag, value in state.metadata["flags"].items():
            command += [f"--{flag}", value]
        # An epoch is a repetition of the same run: only the seeds of its episodes differ.
        command += ["--runs", str(state.epoch), "--repetition", str(state.epoch), "--lanes", "1", "--fresh"]
        command += ["--policy", "external", "--step-timeout", str(_PATIENCE_SECONDS), "--out", str(run)]
        if out is None:
            command.append("--discard")
        policy = _Model(image_budget)
        try:
            log = await _execute(dying_with_this_process(command), policy)
            state.metadata["episode"] = _result(run, log)
        finally:
            # Inspect scores and logs a sample that one of its limits stops, too.
            if "episode" not in state.metadata:
                state.metadata["steps"] = policy.answers
            state.output = policy.output
            if policy.messages:
                state.messages = policy.messages
            if out is None:
                shutil.rmtree(run, ignore_errors=True)
        state.completed = True
        return state

    return solve


@scorer(
    metrics={
        "success": [grouped(mean(), "condition"), stderr()],
        "spl": [grouped(mean(), "condition"), stderr()],
        "steps": [mean()],
    }
)
def episode_scorer() -> Scorer:
    """The result of the episode: success, success weighted by path length, steps. An episode that a limit of Inspect stops is not
    finished, and counts as failed. One that an error stops has no score."""

    async def score(state: TaskState, target: Target) -> Score | None:
        episode = state.metadata.get("episode")
        if episode is None:
            limits = [event for event in transcript().events if isinstance(event, SampleLimitEvent)]
            if not limits:
                return None
            return Score(
                value={"success": 0.0, "spl": 0.0, "steps": float(state.metadata.get("steps", 0))},
                explanation=f"The episode was not finished, and counts as failed: {limits[-1].message}",
            )
        value = {name: float(episode[name]) for name in ("success", "spl", "steps")}
        return Score(value=value, answer=episode["ending"])

    return score


@dataclass(frozen=True)
class _Question:
    """What the policy asks the model."""

    messages: list[ChatMessage]
    reply: Future[ModelOutput]
    """Cancelled when the solver ends before."""


class _Model(Policy):
    """Has the solver ask the model that Inspect evaluates, in the task that Inspect limits and cancels. Used in a worker thread."""

    def __init__(self, image_budget: int) -> None:
        self.image_budget = image_budget
        self.name = "inspect"
        self.questions, self._asked = anyio.create_memory_object_stream[_Question](1)
        self._last: _Question | None = None
        self.messages: list[ChatMessage] = []
        self.output = ModelOutput()
        self.answers = 0

    def facts(self) -> dict[str, str]:
        return {"model": str(get_model()), "prompt": VERSION}

    def act(self, batch: Sequence[Request]) -> Sequence[Answer]:
        return [self._ask(request) for request in batch]

    def _ask(self, request: Request) -> Answer:
        prompt = render(request, self.image_budget)
        question = _Question(_messages(prompt), Future())
        try:
            anyio.from_thread.run_sync(self._send, question)
            output = question.reply.result()
        except (anyio.BrokenResourceError, CancelledError):
            return Failed("Inspect has stopped the sample")
        tokens = output.usage
        usage = Usage(
            prompt_tokens=tokens.input_tokens if tokens else None,
            completion_tokens=tokens.output_tokens if tokens else None,
            cached_tokens=tokens.input_tokens_cache_read if tokens else None,
            finish_reason=output.stop_reason,
            model=output.model,
        )
        refused = output.stop_reason == "content_filter"
        cut_off = output.stop_reason in ("max_tokens", "model_length")
        answer = Outcome.REFUSED if refused else read_answer(output.completion, cut_off, request.world)
        rest: dict[str, Any] = {"images": prompt.images_sent, "usage": usage}
        return Decision(None, answer, **rest) if isinstance(answer, Outcome) else Decision(answer, **rest)

    def _send(self, question: _Question) -> None:
        self.questions.send_nowait(question)
        self._last = question

    async def answer(self) -> None:
        """Answers questions until the run ends. What the model raises ends the policy, too."""
        try:
            with self._asked as questions:
                async for question in questions:
                    output = await _model().generate(question.messages)
                    self.messages, self.output = [*question.messages, output.message], output
                    self.answers += 1
                    question.reply.set_result(output)
        finally:
            # Also one that has not been received. There is no more than one, and the next cannot be sent.
            if self._last is not None:
                self._last.reply.cancel()


def _model() -> Model:
    """The model that Inspect evaluates."""
    model = get_model()
    if str(model).startswith("mockllm/"):
        # Inspect counts the tokens of mock models with a table that tiktoken would download.
        model.api.count_text_tokens = _count_characters
    return model


async def _count_characters(text: str) -> int:
    return max(1, len(text) // 4)


def _messages(prompt: Prompt) -> list[ChatMessage]:
    content: list[Content] = [
        ContentText(text=part.text or "") if part.frame is None else ContentImage(image=data_url(part.frame))
        for part in prompt.parts
    ]
    user: str | list[Content] = content
    if prompt.images_sent == 0:
        user = "".join(part.text or "" for part in prompt.parts)
    return [ChatMessageSystem(content=prompt.system), ChatMessageUser(content=user)]


async def _execute(command: Sequence[str], policy: _Model) -> str:
    """Executes a run with `policy`. Returns what it printed about itself.

    Raises what the model raises, once the run has stopped.
    """
    # An interrupt of the terminal is for Inspect, which stops the run.
    process = await anyio.open_process(command, stdout=subprocess.DEVNULL, start_new_session=True)
    log: list[str] = []
    raised: Exception | None = None
    try:
        folder = await _folder(process, log)
        async with anyio.create_task_group() as group:
            group.start_soon(_read, process, log)
            if folder is not None:
                group.start_soon(_serve, policy, folder, log)
                try:
                    await policy.answer()
                except Exception as error:
                    # Inspect decides what it means for the sample. The group would wrap it.
                    raised = error
                    _stop(process)
                except BaseException:
                    _stop(process)
                    raise
        await process.wait()
    finally:
        _stop(process)
        with anyio.CancelScope(shield=True):
            await process.wait()
    if raised is not None:
        raise raised
    return "".join(log)


def _stop(process: anyio.abc.Process) -> None:
    if process.returncode is None:
        with suppress(ProcessLookupError):
            process.terminate()


async def _serve(policy: _Model, folder: str, log: list[str]) -> None:
    """Serves `policy` until the run ends, also when it is cancelled: the thread uses the run's shared memory."""
    # Of its own, because it is occupied until the run ends.
    thread = anyio.CapacityLimiter(1)
    with policy.questions:
        try:
            await anyio.to_thread.run_sync(serve, policy, folder, limiter=thread)
        except MemTransferError as error:
            log.append(str(error))


async def _folder(process: anyio.abc.Process, log: list[str]) -> str | None:
    """The folder that the run prints for its policy; `None` if it ends before that."""
    while "MEMTRANSFER_ATTACH=" not in "".join(log).rpartition(" ")[0]:
        if not await _read_some(process, log):
            return None
    return "".join(log).split("MEMTRANSFER_ATTACH=")[1].split()[0]


async def _read(process: anyio.abc.Process, log: list[str]) -> None:
    while await _read_some(process, log):
        pass


async def _read_some(process: anyio.abc.Process, log: list[str]) -> bool:
    assert process.stderr is not None
    try:
        log.append((await process.stderr.receive()).decode(errors="replace"))
    except anyio.EndOfStream:
        return False
    return True


def _result(run: Path, log: str) -> dict[str, Any]:
    """The result of the only episode of `run`."""
    try:
        _, _, columns, _, damaged = _native.read_run(run)
    except (FileNotFoundError, ValueError):
        raise RuntimeError(f"memtransfer did not run the episode:\n{log}") from None
    if damaged:
        raise RuntimeError(f"the log of the episode is damaged: {'; '.join(damaged)}\n{log}")
    episode = {name: values[0] for name, _, values in columns if values}
    if episode.get("success") is None:
        raise RuntimeError(f"the episode has no result: {episode.get('error')}\n{log}")
    return {name: value for name, value in episode.items() if value is not None}


def _listed(*arguments: str) -> list[dict[str, Any]]:
    command = [str(program()), "ls", *arguments, "--json"]
    listed = subprocess.run(command, capture_output=True, text=True)
    if listed.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} failed: {listed.stderr.strip()}")
    rows: list[dict[str, Any]] = json.loads(listed.stdout)
    return rows
