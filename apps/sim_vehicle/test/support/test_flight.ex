defmodule SimVehicle.TestFlight do
  @moduledoc """
  Flies a pure vehicle in tests: every function takes and returns `{vehicle, log}`, the log being what it did, newest
  last, each entry `{seconds, action}`.
  """

  alias MavCodec.Messages, as: M
  alias SimVehicle.Vehicle
  alias SimVehicle.Server.{Options, Simulation}

  @gcs {255, 190}

  @doc "A booted vehicle of a firmware; options as for `SimVehicle.start_link/1`."
  def boot(firmware, opts \\ []) do
    {vehicle, actions} =
      [firmware: firmware]
      |> Keyword.merge(opts)
      |> Options.validate!()
      |> Vehicle.new()
      |> Simulation.boot(1_795_213_318_360_000)

    {vehicle, stamp(vehicle, actions)}
  end

  @doc "A vehicle that could be armed, heard by a ground station, with an empty log."
  def ready(firmware, opts \\ []) do
    {vehicle, _log} = firmware |> boot(Keyword.merge([ready_s: 4.0], opts)) |> run(5) |> heartbeat() |> run(1)
    {vehicle, []}
  end

  @doc "Armed and hovering at `height` metres, with an empty log."
  def flying(firmware, height \\ 20, opts \\ []) do
    {vehicle, log} = firmware |> ready(opts) |> mode(hold(firmware)) |> command(400, [1.0])
    {vehicle, _log} = {vehicle, log} |> takeoff(height) |> until(&(&1.airborne and &1.landed == :in_air), 60)
    {vehicle, []}
  end

  def hold(:ardupilot), do: [1.0, 4.0]
  def hold(:px4), do: [1.0, 4.0, 3.0]

  def takeoff({%{plans: %{style: :px4}} = v, _log} = flight, height),
    do: command(flight, 22, [0.0, 0.0, 0.0, :nan, :nan, :nan, v.origin.alt + height])

  def takeoff(flight, height), do: command(flight, 22, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height * 1.0])

  def mode(flight, params), do: command(flight, 176, params)

  @doc "Lets seconds pass in steps of 50 ms."
  def run({vehicle, log}, seconds) do
    {vehicle, new} =
      Enum.reduce(1..max(round(seconds * 20), 1), {vehicle, []}, fn _step, {vehicle, new} ->
        {vehicle, actions} = Simulation.step(vehicle, 0.05)
        {vehicle, [stamp(vehicle, actions) | new]}
      end)

    {vehicle, log ++ (new |> Enum.reverse() |> Enum.concat())}
  end

  @doc "Runs until `fun` is true of the vehicle, at most `seconds`."
  def until({vehicle, log}, fun, seconds) do
    Enum.reduce_while(1..(seconds * 20), {vehicle, log}, fn _step, {vehicle, log} ->
      if fun.(vehicle) do
        {:halt, {vehicle, log}}
      else
        {vehicle, actions} = Simulation.step(vehicle, 0.05)
        {:cont, {vehicle, log ++ stamp(vehicle, actions)}}
      end
    end)
    |> tap(fn {vehicle, _log} ->
      unless fun.(vehicle),
        do: raise("not within #{seconds} s: #{inspect(SimVehicle.Vehicle.View.of(vehicle))}")
    end)
  end

  def command(flight, id, params \\ [], opts \\ []) do
    fields = Enum.zip([:param1, :param2, :param3, :param4, :param5, :param6, :param7], params)
    target = [target_system: opts[:system] || 1, target_component: opts[:component] || 1]
    hear(flight, struct!(M.CommandLong, [command: id] ++ target ++ fields))
  end

  def heartbeat(flight, source \\ @gcs), do: hear(flight, %M.Heartbeat{type: 6, autopilot: 8}, source)
  def hear(flight, message, source \\ @gcs), do: handle(flight, {:message, message, source})

  def handle({vehicle, log}, event) do
    {vehicle, actions} = Simulation.handle(vehicle, event)
    {vehicle, log ++ stamp(vehicle, actions)}
  end

  @doc "Uploads a plan as a ground station does; the acknowledgement is in the log."
  def upload({_vehicle, _log} = flight, items, type \\ 0) do
    flight =
      hear(flight, %M.MissionCount{
        target_system: 1,
        target_component: 1,
        count: length(items),
        mission_type: type
      })

    items
    |> Enum.with_index()
    |> Enum.reduce(flight, fn {item, seq}, flight ->
      fields =
        Map.merge(
          %{seq: seq, target_system: 1, target_component: 1, mission_type: type, autocontinue: 1},
          item
        )

      hear(flight, struct!(M.MissionItemInt, fields))
    end)
  end

  # --- looking at a log ---

  def clear({vehicle, _log}), do: {vehicle, []}
  def vehicle({vehicle, _log}), do: vehicle
  def sent({_vehicle, log}, module), do: for({_at, {:send, %^module{} = message}} <- log, do: message)
  def texts(flight), do: for(%{text: text} <- sent(flight, M.Statustext), do: text)
  def acks(flight), do: for(a <- sent(flight, M.CommandAck), do: {a.command, a.result})

  def events({_vehicle, log}),
    do: for({_at, {:notify, event}} <- log, not match?({:text, _s, _t}, event), do: event)

  @doc "The changes of a value in the messages of a kind: `[{seconds, value}]`."
  def changes({_vehicle, log}, module, fun) do
    for({at, {:send, %^module{} = m}} <- log, do: {at, fun.(m)}) |> Enum.dedup_by(&elem(&1, 1))
  end

  defp stamp(vehicle, actions), do: Enum.map(actions, &{Vehicle.seconds(vehicle), &1})
end
