defmodule Aerie.ClientCase do
  @moduledoc """
  Tests of the faces for clients: a gateway's parts without links, a folder short enough for unix sockets, vehicles that
  are only snapshots in the store.
  """
  use ExUnit.CaseTemplate

  alias Aerie.Base.Store

  using do
    quote do
      import Aerie.ClientCase
    end
  end

  defdelegate short_dir, to: Aerie.ShortDir, as: :new

  @doc "Starts store, notices and the clients' faces of a gateway, with sockets in `dir`; gives its name."
  @spec start_clients(Path.t(), map()) :: reference()
  def start_clients(dir, sockets \\ %{}) do
    gateway = make_ref()

    sockets =
      Map.merge(%{enabled: true, dir: dir, state_hz: 50.0, max_clients: 4}, sockets)

    config = %{sockets: sockets}

    for module <- [
          Aerie.Base.Store,
          Aerie.Base.PubSub,
          MavRouter.Router.Supervisor,
          Aerie.Fleet.Client.Supervisor
        ] do
      options = Aerie.GatewayCase.part(module, gateway, config)
      ExUnit.Callbacks.start_supervised!(Supervisor.child_spec({module, options}, id: {module, gateway}))
    end

    gateway
  end

  @doc "A vehicle's snapshot with the fields that differ from a hovering copter's."
  @spec vehicle(map()) :: map()
  def vehicle(changes \\ %{}) do
    now = System.os_time(:microsecond)
    group = fn data -> %{at: now, time_boot_ms: 1000, data: data} end

    Map.merge(
      %Aerie.Vehicle.Snapshot{
        id: "VID-001",
        key: {"main", 1},
        network: "main",
        system_id: 1,
        autopilot: :ardupilot,
        vehicle_type: "copter",
        firmware: "4.5.1",
        status: :online,
        last_heard: now,
        links: ["radio"],
        groups: %{
          mode: group.(%{mode: "GUIDED", armed: true, in_air: true}),
          attitude: group.(%{roll: 1.234567, pitch: -0.5, yaw: 178.5}),
          position:
            group.(%{lat: 12.97161234567, lon: 77.5946, alt_msl: 920.0, alt_rel: 10.25, heading: 178.5}),
          velocity: group.(%{groundspeed: 3.21, airspeed: nil, climb: -0.1}),
          battery: group.(%{voltage: 22.8, current: 0.5, remaining: 0.98}),
          gps: group.(%{fix: 3, satellites: 14, hdop: 0.9})
        }
      },
      changes
    )
  end

  @doc "Puts a vehicle into the store."
  @spec put_vehicle(term(), map()) :: :ok
  def put_vehicle(gateway, vehicle), do: Store.put_vehicle(gateway, vehicle.key, vehicle)

  @doc "Connects to a unix socket, as soon as it is there."
  @spec connect(Path.t(), list()) :: :gen_tcp.socket()
  def connect(path, options \\ []) do
    Aerie.LinkCase.eventually(fn ->
      case :gen_tcp.connect({:local, path}, 0, [:binary, active: false] ++ options) do
        {:ok, socket} -> socket
        {:error, reason} when reason in [:enoent, :econnrefused] -> nil
      end
    end)
  end
end
