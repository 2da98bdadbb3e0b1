"""Stands among the processes of a run for an object of the process that called `evaluate`: run as a script by the run.

It tells that process which run to join, copies the tracebacks that it gets to standard error, which is the run's log, and ends when
the object's service ends. It uses nothing but the standard library, so that it starts at once.
"""

import os
import socket
import sys

ATTACH, SOCKET = "MEMTRANSFER_ATTACH", "_MEMTRANSFER_SOCKET"
"""The folder to join, and the address of the process that called `evaluate`."""


def main(object_name: str) -> int:
    """Returns the exit status."""
    address, folder = os.environ.get(SOCKET), os.environ.get(ATTACH)
    if not address or not folder:
        print(f"{object_name} is an object of the Python process that called `evaluate`: call it again", file=sys.stderr)
        return 2
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as service:
        try:
            service.connect(f"\0{address}")
            service.sendall(f"{object_name}\n{folder}\n".encode())
            # Text for the log, and after a zero byte the exit status.
            received = b""
            while chunk := service.recv(1 << 16):
                received += chunk
                text, zero, status = received.partition(b"\0")
                sys.stderr.buffer.write(text)
                sys.stderr.buffer.flush()
                received = zero + status
        except OSError as error:
            print(f"cannot reach the Python process that called `evaluate`: {error}", file=sys.stderr)
            return 1
    if not received:
        print("the Python process that called `evaluate` has ended", file=sys.stderr)
        return 1
    return int(received[1:])


if __name__ == "__main__":
    sys.exit(main(" ".join(sys.argv[1:])))
