defmodule SimVehicle.Recording do
  @moduledoc """
  Plays what a real firmware was sent in a recording to a simulated vehicle, at the recorded times.
  """

  alias MavCodec.Messages, as: M
  alias SimVehicle.Vehicle
  alias SimVehicle.Server.{Options, Simulation}

  @fixtures Path.expand("../fixtures", __DIR__)

  @doc "A recording by name (`test/fixtures`)."
  @spec load(String.t()) :: map
  def load(name), do: [@fixtures, name <> ".json"] |> Path.join() |> File.read!() |> JSON.decode!()

  @doc "The log of the simulated vehicle, `[{seconds, message}]`, after it heard everything the real one heard."
  @spec replay(map) :: [{float, struct}]
  def replay(recording) do
    [lat, lon, alt] = recording["home"]
    firmware = %{"ardupilot" => :ardupilot, "px4" => :px4}[recording["firmware"]]

    options =
      Options.validate!(
        firmware: firmware,
        home: {lat, lon, alt},
        heading: recording["heading"],
        ready_s: recording["ready_s"]
      )

    {vehicle, actions} = options |> Vehicle.new() |> Simulation.boot(1_795_213_318_360_000)
    dialect = if firmware == :px4, do: MavCodec.Dialects.Upstream, else: MavCodec.Dialects.Ardupilot

    {vehicle, log} =
      Enum.reduce(recording["tx"], {vehicle, stamp(vehicle, actions)}, fn [at, hex], state ->
        state |> run_until(at) |> hear(hex, dialect)
      end)

    {_vehicle, log} = run_until({vehicle, log}, recording["duration"])
    Enum.reverse(log)
  end

  @doc "The messages of a kind as `fun` sees them, only the changes: `[[seconds | values]]` as in a recording."
  @spec changes([{float, struct}], module, (struct -> list)) :: [list]
  def changes(log, module, fun) do
    for({at, %^module{} = m} <- log, do: [at | fun.(m)]) |> Enum.dedup_by(&tl/1)
  end

  defp run_until({vehicle, log}, at) do
    left = at - Vehicle.seconds(vehicle)

    if left <= 0.0005 do
      {vehicle, log}
    else
      {vehicle, actions} = Simulation.step(vehicle, min(left, 0.02))
      run_until({vehicle, stamp(vehicle, actions) ++ log}, at)
    end
  end

  defp hear({vehicle, log}, hex, dialect) do
    {[frame], _parser} =
      MavCodec.Parser.push_datagram(
        MavCodec.Parser.new(dialects: [dialect]),
        Base.decode16!(hex, case: :lower),
        nil
      )

    {:ok, message} = MavCodec.decode(frame, dialect)
    {vehicle, actions} = Simulation.handle(vehicle, {:message, message, {frame.system, frame.component}})
    {vehicle, stamp(vehicle, actions) ++ log}
  end

  # Newest first.
  defp stamp(vehicle, actions) do
    for({:send, message} <- actions, do: {Vehicle.seconds(vehicle), message}) |> Enum.reverse()
  end

  @doc "Acknowledgements as a recording has them."
  @spec acks([{float, struct}]) :: [list]
  def acks(log), do: for({at, %M.CommandAck{} = a} <- log, do: [at, a.command, a.result])
end
