"""YAMSPy as the client of a flight controller at a TCP port: yamspy_reader.py PORT

Prints what it reads, as "name value" lines.
"""
import contextlib
import io
import sys

import serial
from yamspy import MSPy

MESSAGES = "STATUS_EX ATTITUDE ALTITUDE BATTERY_STATE RC RAW_GPS PID FILTER_CONFIG BOXNAMES".split()

board = MSPy(device="none", loglevel="ERROR", logfilename=None)
board.conn = serial.serial_for_url("socket://127.0.0.1:" + sys.argv[1], do_not_open=True, timeout=10)

# It prints what it knows of the board.
with contextlib.redirect_stdout(io.StringIO()):
    if board.__enter__() == 1:
        raise SystemExit("no connection")

for message in MESSAGES:
    if not board.send_RAW_msg(MSPy.MSPCodes["MSP_" + message], data=[]):
        raise SystemExit("not sent: " + message)
    board.process_recv_data(board.receive_msg())

print("variant", board.CONFIG["flightControllerIdentifier"])
print("api", board.CONFIG["apiVersion"])
print("pitch", board.SENSOR_DATA["kinematics"][1])
print("cells", board.BATTERY_STATE["cellCount"])
print("throttle", board.RC["channels"][3])
print("satellites", board.GPS_DATA["numSat"])
print("roll_p", board.PIDs[0][0])
print("boxes", len(board.AUX_CONFIG))
board.conn.close()
