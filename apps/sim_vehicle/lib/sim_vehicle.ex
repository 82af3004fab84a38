defmodule SimVehicle do
  @moduledoc """
  Simulated autopilots that speak real MAVLink over real transports.

      {:ok, sim} = SimVehicle.start_link(firmware: :ardupilot, link: "udpout:127.0.0.1:14550", system: 7, speed: 10)
      SimVehicle.await(sim, & &1.ready)
      SimVehicle.fault(sim, :loss, 0.25)
      SimVehicle.failsafe(sim, :battery)

  `SimVehicle.Server.Options.table/0` lists the options. An unknown option or a wrong value is refused with what was
  expected.
  `SimVehicle.Fleet` starts several that fly by themselves.
  """

  alias SimVehicle.Server
  alias SimVehicle.Server.Options

  @type sim :: GenServer.server()

  @doc false
  def child_spec(opts) do
    %{id: {__MODULE__, opts[:system] || 1}, start: {__MODULE__, :start_link, [opts]}, restart: :transient}
  end

  @doc """
  Starts a vehicle, linked to the caller. `{:error, text}` for wrong options, `{:error, {:link, address, reason}}` when
  its socket cannot be opened.
  """
  @spec start_link(keyword) :: GenServer.on_start() | {:error, String.t()}
  def start_link(opts \\ []) do
    with {:ok, options} <- Options.validate(opts), do: Server.start_link(options)
  end

  @doc "What the vehicle is doing (`t:SimVehicle.Vehicle.View.t/0`)."
  @spec state(sim) :: SimVehicle.Vehicle.View.t()
  def state(sim), do: GenServer.call(sim, :state, :infinity)

  @doc "The local port of its link."
  @spec port(sim) :: :inet.port_number()
  def port(sim), do: GenServer.call(sim, :port, :infinity)

  @doc """
  Counters: `sent` and `received` frames, `refused` ones (not signed with its key), `unsent` (no peer), `faults` by direction
  and kind (`offered`, `passed`, `lost`, `duplicated`, `reordered`, `corrupted`, `silenced`, `overflow`), `parser`.
  """
  @spec stats(sim) :: map
  def stats(sim), do: GenServer.call(sim, :stats, :infinity)

  @doc """
  Waits until `fun`, called with the vehicle's view, returns something other than false or nil, and returns that. Exits after
  `timeout` ms of real time. The function runs in the vehicle's process.
  """
  @spec await(sim, (SimVehicle.Vehicle.View.t() -> term), timeout) :: term
  def await(sim, fun, timeout \\ 180_000), do: GenServer.call(sim, {:await, fun}, timeout)

  @doc "Sends `{:sim, pid, event}` (`t:SimVehicle.Vehicle.event/0`) to the caller from now on."
  @spec subscribe(sim) :: :ok
  def subscribe(sim), do: GenServer.call(sim, {:subscribe, self()}, :infinity)

  @doc """
  Sets a fault of the link (`SimVehicle.Link.Faults`) or of the vehicle:

  - `:freeze` true/false: the firmware hangs: its time stands still, nothing is received or sent
  - `:clock_jump` seconds: its UTC clock jumps
  - `:drop` true: its connection is lost once
  """
  @spec fault(sim, atom, term, :out | :in) :: :ok | {:error, String.t()}
  def fault(sim, name, value, direction \\ :out),
    do: GenServer.call(sim, {:fault, name, value, direction}, :infinity)

  @doc "Begins a failsafe: `:battery`, `:battery_critical`, `:gcs`, `:rc`, `:fence`, `:ekf` or `:gps`; false ends it."
  @spec failsafe(sim, atom, boolean) :: :ok
  def failsafe(sim, kind, on? \\ true)
      when kind in [:battery, :battery_critical, :gcs, :rc, :fence, :ekf, :gps] and is_boolean(on?),
      do: GenServer.call(sim, {:handle, {:failsafe, kind, on?}}, :infinity)

  @doc "Power is lost and comes back a second later; in the air the vehicle falls."
  @spec reboot(sim) :: :ok
  def reboot(sim), do: GenServer.call(sim, :reboot, :infinity)

  @doc "Gives the vehicle any event of `SimVehicle.Server.Simulation.handle/2`."
  @spec happen(sim, term) :: :ok
  def happen(sim, event), do: GenServer.call(sim, {:handle, event}, :infinity)
end
