# Long suites run with `bin/test --full`, hour-long ones with `bin/test --soak`.
# Ground stations written in Python need the environment that bin/setup makes.
# bin/run and its like: from the code that is compiled already, but as users have it in the long run, which has time.
if :long not in ExUnit.configuration()[:include], do: System.put_env("AERIE_BUILD", "test")

Aerie.Patience.load_code()
Application.put_env(:vehicle, :gateway_parts, [Aerie.ControlParts, Aerie.FleetParts])

# Most tests wait for vehicles and servers rather than compute, so more of them run at once than there are cores.
ExUnit.start(
  max_cases: Aerie.Patience.cases(),
  exclude: [:long, :soak] ++ Aerie.PeerCase.missing() ++ Aerie.Browser.excluded()
)
