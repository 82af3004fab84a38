defmodule Aerie.Vehicle.DealingsTest do
  @moduledoc "What the gateway would have sent in recorded flights of real firmware."
  use ExUnit.Case, async: true

  import Aerie.Flight, only: [frame: 2, frames: 1, run: 1, run: 2]

  alias Aerie.Vehicle.Core
  alias MavCodec.Messages, as: M

  @second 1_000_000

  defp sent(run), do: for({:send, message, _version} <- run.actions, do: message)

  defp ids(messages, command),
    do: for(%M.CommandLong{command: ^command, param1: id} <- messages, do: trunc(id))

  for recording <- ~w(arducopter_flight arducopter_mavlink1 ardurover_drive px4_flight px4_refusals) do
    test "#{recording}: only what did not come was asked for, three times at most; nobody was accused" do
      frames = frames(unquote(recording))
      run = run(frames)
      # The recordings have been thinned out, and two of them have a reboot in them.
      reboots = Enum.count(run.events, &(&1.type == "reboot"))
      asked = ids(sent(run), 511)
      assert Enum.all?(Enum.frequencies(asked), fn {_id, n} -> n <= 3 * (reboots + 1) end)
      # What came every second is among none of them.
      steady = for {id, n} <- Enum.frequencies_by(frames, & &1.id), n > 100, do: id
      assert reboots > 0 or asked -- steady == asked
      refute Enum.any?(run.events, &(&1.type in ["stream.contested", "collision", "gcs.lost"]))
      # Clocks: nobody answered in a recording, so it was asked ever more seldom.
      requests = for %M.Timesync{} = request <- sent(run), do: request
      span = div(List.last(frames).at - hd(frames).at, @second)
      assert length(requests) in 1..(6 * (reboots + 1) + div(span, 60) + 1)
      # Parameters: each twice at most per boot.
      names = for %M.ParamRequestRead{param_id: name} <- sent(run), do: name
      assert Enum.all?(Enum.frequencies(names), fn {_name, n} -> n <= 2 * (reboots + 1) end)
    end
  end

  test "rebuilt from its snapshot it knows the parameters and does not read them again" do
    copter = frame(%M.Heartbeat{type: 2, autopilot: 3}, 10 * @second)
    value = %M.ParamValue{param_id: "SYSID_MYGCS", param_value: 255.0, param_type: 4, param_index: 65_535}
    run = run([copter, frame(value, 11 * @second)], batch: 1)
    assert %{failsafe_gcs: 255} = Core.snapshot(run.core).gcs
    rebuilt = Core.new(run.core.options, Core.snapshot(run.core))
    {core, _actions} = Core.handle(rebuilt, {:tick, 12 * @second})
    assert %{failsafe_gcs: 255} = Core.snapshot(core).gcs
  end
end
