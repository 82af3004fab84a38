defmodule Aerie.Vehicle.Session.Core.ServicesTest do
  @moduledoc "What the gateway would have sent in recorded flights of real firmware."
  use ExUnit.Case, async: true

  import Aerie.Flight, only: [frame: 2, frames: 1, run: 1, run: 2]

  alias Aerie.Vehicle.Session.Core
  alias MavCodec.Messages, as: M

  @second 1_000_000

  defp sent(run), do: for({:send, message, _version} <- run.actions, do: message)

  defp ids(messages, command),
    do: for(%M.CommandLong{command: ^command, param1: id} <- messages, do: trunc(id))

  for recording <- ~w(arducopter_flight arducopter_mavlink1 ardurover_drive px4_flight px4_refusals) do
    test "#{recording}: only missing messages were requested, three times at most; nothing was reported as contested" do
      frames = frames(unquote(recording))
      run = run(frames)
      # The recordings were thinned out, and two of them have a reboot.
      reboots = Enum.count(run.events, &(&1.type == "reboot"))
      asked = ids(sent(run), 511)
      assert Enum.all?(Enum.frequencies(asked), fn {_id, n} -> n <= 3 * (reboots + 1) end)
      # Messages that came every second were not requested.
      steady = for {id, n} <- Enum.frequencies_by(frames, & &1.id), n > 100, do: id
      assert reboots > 0 or asked -- steady == asked
      refute Enum.any?(run.events, &(&1.type in ["stream.contested", "collision", "gcs.lost"]))
      # Nothing answers TIMESYNC in a recording, so requests become rare.
      requests = for %M.Timesync{} = request <- sent(run), do: request
      span = div(List.last(frames).at - hd(frames).at, @second)
      assert length(requests) in 1..(6 * (reboots + 1) + div(span, 60) + 1)
      # Each parameter at most twice per boot.
      names = for %M.ParamRequestRead{param_id: name} <- sent(run), do: name
      assert Enum.all?(Enum.frequencies(names), fn {_name, n} -> n <= 2 * (reboots + 1) end)
    end
  end

  test "a core restored from its snapshot knows the parameters and does not read them again" do
    copter = frame(%M.Heartbeat{type: 2, autopilot: 3}, 10 * @second)
    value = %M.ParamValue{param_id: "SYSID_MYGCS", param_value: 255.0, param_type: 4, param_index: 65_535}
    run = run([copter, frame(value, 11 * @second)], batch: 1)
    assert %{failsafe_gcs: 255} = Core.snapshot(run.core).gcs
    rebuilt = Core.new(run.core.options, Core.snapshot(run.core))
    {core, _actions} = Core.handle(rebuilt, {:tick, 12 * @second})
    assert %{failsafe_gcs: 255} = Core.snapshot(core).gcs
  end
end
