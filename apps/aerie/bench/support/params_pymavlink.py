"""All parameters of a vehicle with pymavlink: params_pymavlink.py PORT list|file. Prints the number and the seconds.

list: PARAM_REQUEST_LIST, and after a second of silence the missing ones by index, ten at a time.
file: pymavlink's own mavftp, `@PARAM/param.pck`.
"""
import os
import sys
import tempfile
import time

from pymavlink import mavftp, mavutil

port, way = sys.argv[1], sys.argv[2]
m = mavutil.mavlink_connection("udpin:127.0.0.1:" + port, source_system=255, source_component=190, dialect="ardupilotmega")
m.wait_heartbeat()
start = time.time()


def by_list():
    values, count = {}, None
    m.mav.param_request_list_send(1, 1)
    silent = time.time()
    while count is None or len(values) < count:
        p = m.recv_match(type="PARAM_VALUE", blocking=True, timeout=0.05)
        if p is not None:
            silent = time.time()
            count = p.param_count
            if p.param_index != 65535:
                values[p.param_index] = p.param_value
        elif time.time() - silent > 1:
            silent = time.time()
            if count is None:
                m.mav.param_request_list_send(1, 1)
            else:
                for index in [i for i in range(count) if i not in values][:10]:
                    m.mav.param_request_read_send(1, 1, b"", index)
    return count


def by_file():
    path = os.path.join(tempfile.mkdtemp(), "params")
    ftp = mavftp.MAVFTP(m, target_system=1, target_component=1)
    ftp.cmd_getparams([path])
    ftp.process_ftp_reply("getparams", timeout=120)
    with open(path, encoding="utf-8") as file:
        return len([line for line in file if line.strip() and not line.startswith("#")])


n = by_list() if way == "list" else by_file()
print(n, time.time() - start)
