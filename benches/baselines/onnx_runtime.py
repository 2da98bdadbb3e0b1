"""ONNX Runtime from Python, the package from PyPI: how fast it runs a model on images that are already tensors.

    {"do": "open", "model": "FILE", "threads": 2, "provider": "cpu"}    ->    {"version": "...", "setting": "..."}
    {"do": "time", "images": 40}                                        ->    {"images_per_second": 20.0}

"open" tries one session of all threads and as many sessions of one thread, and keeps the faster way. Its tensors are
made beforehand: preparing images is not part of what is measured here.
"""

import threading
import time

import numpy
import onnxruntime

from _serve import serve

TRIAL_IMAGES = 12

# Each with its options, which are those of ours (memory-proc/src/encoder/provider.rs).
PROVIDERS = {
    "cpu": ("CPUExecutionProvider", {}),
    "openvino": ("OpenVINOExecutionProvider", {}),
    "cuda": ("CUDAExecutionProvider", {"use_tf32": "0", "cudnn_conv_algo_search": "DEFAULT"}),
    "tensorrt": ("TensorrtExecutionProvider", {}),
}

sessions = []


def make(model, count, threads, provider):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    made = [onnxruntime.InferenceSession(model, options, providers=[PROVIDERS[provider]]) for _ in range(count)]
    used = made[0].get_providers()[0]
    if used != PROVIDERS[provider][0]:
        raise RuntimeError(f"ONNX Runtime computes on {used} instead of {PROVIDERS[provider][0]}")
    return made


def rate(sessions, images):
    """Returns images per second, distributed evenly over the sessions."""

    def work(session, count):
        given = session.get_inputs()[0]
        tensor = numpy.random.default_rng(0).standard_normal(given.shape, dtype=numpy.float32)
        session.run(None, {given.name: tensor})
        ready.wait()
        for _ in range(count):
            session.run(None, {given.name: tensor})

    ready = threading.Barrier(len(sessions) + 1)
    each = max(1, images // len(sessions))
    workers = [threading.Thread(target=work, args=(session, each)) for session in sessions]
    for worker in workers:
        worker.start()
    ready.wait()
    began = time.perf_counter()
    for worker in workers:
        worker.join()
    return each * len(sessions) / (time.perf_counter() - began)


def open_model(model, threads, provider):
    global sessions
    ways = [(1, threads), (threads, 1)]
    tried = [(rate(made := make(model, *way, provider), TRIAL_IMAGES), way, made) for way in dict.fromkeys(ways)]
    _, (count, each), sessions = max(tried, key=lambda it: it[0])
    setting = f"sessions: {count}, threads in each: {each}"
    return {"version": onnxruntime.__version__, "setting": setting}


def time_images(images):
    return {"images_per_second": rate(sessions, images)}


serve(open=open_model, time=time_images)
