"""Ask the workers of a running cluster, before any work, whether they have this package and see the store."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pgcp
from pgcp.errors import InputError

_ANSWER_S = 4.0  # one that does not answer may be paused, and is waited for later
_SHARED = "give --store a folder that all machines have under the same path, and may write to"


def _probe(folder: str, token: str, answer: str) -> Callable[[], tuple[str, str]]:
    """What a worker is asked: its version of the package and what it cannot do with the store, each empty where there is none.

    It is sent as code, since what it would be loaded from may not be there.
    """

    def probe() -> tuple[str, str]:
        """Answer."""
        from pathlib import Path

        try:
            import pgcp

            version = pgcp.__version__
        except Exception:  # whatever else is called pgcp there
            version = ""
        try:
            if (Path(folder) / token).read_text() != token:
                return version, "sees another folder of the same name as"
        except OSError as problem:
            return version, f"cannot read ({problem.strerror})"
        try:
            (Path(folder) / answer).write_text(answer)
        except OSError as problem:
            return version, f"cannot write to ({problem.strerror})"
        return version, ""

    return probe


def _answers(client: Any, questions: dict[str, Callable[[], Any]]) -> dict[str, Any]:
    """What each worker answers its own question, by address; those that do not answer in time are left out."""

    async def ask() -> list[Any]:
        """All at once."""
        asked = [client.run(question, workers=[address], on_error="return") for address, question in questions.items()]
        return await asyncio.gather(*(asyncio.wait_for(one, _ANSWER_S) for one in asked), return_exceptions=True)

    out: dict[str, Any] = {}
    for answer in client.sync(ask):
        if isinstance(answer, dict):
            out |= answer
    return out


def check_workers(client: Any, workers: dict[str, Any], store: Path) -> None:
    """Raise InputError, which names a worker and what to do, where one has another version or does not see the store.

    client: of the cluster; workers: what its scheduler knows of each, by address.
    """
    token = f".pgcp-probe-{uuid.uuid4().hex}"
    names = {address: f"{token}-{number}" for number, address in enumerate(workers)}
    try:
        (store / token).write_text(token)
    except OSError as problem:
        raise InputError(f"{store}: cannot write to the store: {problem.strerror}") from problem
    try:
        answers = _answers(client, {address: _probe(str(store), token, name) for address, name in names.items()})
        problems = {address: said for address, answer in answers.items() if (said := _problem(answer, store))}
    finally:
        for name in (token, *names.values()):
            with suppress(OSError):
                (store / name).unlink()
    if problems:
        address, said = next(iter(problems.items()))
        host = workers[address].get("host", "")
        more = f"; {len(problems) - 1} more of {len(workers)} workers are no better" if len(problems) > 1 else ""
        raise InputError(f"the worker {address}{f' on {host}' if host and host not in address else ''} {said}{more}")


def _problem(answer: Any, store: Path) -> str:
    """What is wrong with a worker by its answer, and what helps; empty where nothing is."""
    if not isinstance(answer, tuple):
        return f"fails at the simplest task ({answer}); install one version of Python and dask on all machines"
    version, cannot = answer
    if version != pgcp.__version__:
        has = f"has pgcp {version}" if version else "has no package pgcp"
        return f"{has}, this run has {pgcp.__version__}; install one version on all machines"
    return f"{cannot} the store {store}; {_SHARED}" if cannot else ""
