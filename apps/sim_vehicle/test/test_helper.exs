# Long suites run with `bin/test --full`, hour-long ones with `bin/test --soak`; peers written in Python need the
# environment that bin/setup makes.
ExUnit.start(exclude: [:long, :soak] ++ if(SimVehicle.PythonPeer.python(), do: [], else: [:python]))
