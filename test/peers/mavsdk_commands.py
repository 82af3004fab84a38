"""MAVSDK as a ground station that is told what to do: mavsdk_commands.py URL SYSTEM

Reads a line of JSON for each call, {"call": "PLUGIN.METHOD", "args": [...]}, and prints "answer JSON" with its result: the name
of MAVSDK's result code. An argument {"CLASS": [...]} is an object of the plugin. A method that MAVSDK has without a blocking form
(calibration) is called with a callback, and its last result counts.
"""
import importlib
import json
import os
import queue
import sys
import time

from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.component_type import ComponentType
from mavsdk.connection_result import ConnectionResult
from mavsdk.exceptions import MavsdkError


def connect(url, system_id):
    sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    result = sdk.add_any_connection(url)
    if result != ConnectionResult.SUCCESS:
        raise SystemExit("no connection: %s" % result)
    while True:
        for system in sdk.get_systems():
            if system.get_system_id() == system_id and system.has_autopilot():
                return sdk, system
        time.sleep(0.05)


def plugin(system, plugins, name):
    module = importlib.import_module("mavsdk.plugins.%s.%s" % (name, name))
    if name not in plugins:
        plugins[name] = getattr(module, "".join(part.capitalize() for part in name.split("_")))(system)
    return module, plugins[name]


def argument(module, value):
    if isinstance(value, dict):
        [(name, args)] = value.items()
        return getattr(module, name)(*args)
    return value


def call(system, plugins, order):
    name, method = order["call"].split(".")
    module, instance = plugin(system, plugins, name)
    args = [argument(module, value) for value in order["args"]]
    if hasattr(instance, method):
        try:
            getattr(instance, method)(*args)
            return "SUCCESS"
        except MavsdkError as error:
            return error.result.name
    results = queue.Queue()
    getattr(instance, method + "_async")(*args, lambda result, *_: results.put(result.name))
    while True:
        result = results.get(timeout=300)
        if result not in ("NEXT", "INSTRUCTION", "IN_PROGRESS"):
            return result


def main(url, system_id):
    sdk, system = connect(url, system_id)
    plugins = {}
    for line in sys.stdin:
        answer = "\nanswer " + json.dumps({"result": call(system, plugins, json.loads(line))}) + "\n"
        # At once, because MAVSDK writes its log between.
        os.write(1, answer.encode())
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
