"""Work in a second thread."""

from __future__ import annotations

import multiprocessing
import sys
import threading

import pytest

from facemime.core.numeric.second_thread import SecondThread


def test_work_is_done_in_order_in_one_other_thread() -> None:
    second, order = SecondThread(), list[int]()
    futures = [second.begin(lambda i=i: order.append(i) or threading.get_ident()) for i in range(20)]
    idents = {future.result() for future in futures}
    assert order == list(range(20))
    assert len(idents) == 1
    assert threading.get_ident() not in idents


def test_errors_of_the_work_reach_the_caller_and_later_work_is_done() -> None:
    second = SecondThread()
    with pytest.raises(ZeroDivisionError):
        second.begin(lambda: 1 // 0).result()
    assert second.begin(lambda: "done").result() == "done"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not fork")
def test_a_forked_process_has_a_second_thread_of_its_own() -> None:
    second = SecondThread()
    assert second.begin(lambda: 1).result() == 1
    receiver, sender = multiprocessing.get_context("fork").Pipe(duplex=False)
    child = multiprocessing.get_context("fork").Process(target=lambda: sender.send(second.begin(lambda: 2).result(20)))
    child.start()
    assert receiver.poll(30)
    assert receiver.recv() == 2
    child.join(30)
    assert child.exitcode == 0
