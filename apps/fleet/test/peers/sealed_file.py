#!/usr/bin/env python3
"""A file that nobody can make shorter, whoever they are, with the bytes given in hexadecimal. Says its path; ends, and the
file with it, when its standard input does.
"""
import fcntl
import os
import sys

file = os.memfd_create("sealed", os.MFD_ALLOW_SEALING)
os.write(file, bytes.fromhex(sys.argv[1]))
fcntl.fcntl(file, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK)
print(f"file /proc/{os.getpid()}/fd/{file}", flush=True)
sys.stdin.read()
