defmodule Aerie.Control.CommandExecutor.RecordedTest do
  @moduledoc "What real PX4 refused, byte for byte, through session and executor: the result has its words."
  use Aerie.GatewayCase, async: true

  import Aerie.Flight, only: [frames: 1]

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.CommandExecutor
  alias Aerie.Vehicle.Command

  @key {"main", 1}
  # As pymavlink, which was refused, so that the acknowledgements are ours. A vehicle that a busy machine delays is not lost.
  @us %{
    mavlink: %{system_id: 255, component_id: 190},
    timeouts: %{vehicle_stale_s: 60.0, vehicle_lost_s: 120.0}
  }

  setup do
    gateway = start_gateway(@us, with: [:router])
    {:ok, gateway: gateway, frames: frames("px4_refusals_acks")}
  end

  defp deliver(gateway, frames),
    do: Aerie.Reader.deliver(gateway, %{id: "radio", network: "main", peer: :one}, frames)

  # Seconds since the first frame.
  defp between(frames, from, to) do
    [%{at: start} | _frames] = frames
    Enum.filter(frames, &(&1.at - start >= from * 1_000_000 and &1.at - start < to * 1_000_000))
  end

  defp refused(c, type, params, {from, to}) do
    deliver(c.gateway, between(c.frames, 0, from))
    # Its answers have to come before the command is given up.
    answers = between(c.frames, from, to)
    eventually(fn -> Store.vehicle(c.gateway, @key) end)
    {:ok, command} = Command.new(vehicle: "VID-001", type: type, params: params)
    task = Task.async(fn -> CommandExecutor.submit(c.gateway, @key, command) end)

    eventually(fn ->
      :sys.get_state(Names.via(c.gateway, :session, @key), Aerie.Patience.ms()).listeners != %{}
    end)

    deliver(c.gateway, answers)
    Task.await(task, Aerie.Patience.ms())
  end

  test "arming while it calibrates: an event, and no text of it", c do
    assert %{status: :rejected, reason: reason} = refused(c, "arm", %{}, {95.0, 95.14})
    assert reason =~ "TEMPORARILY_REJECTED; it said: arm denied calibrating"
  end

  test "arming with failing checks: the text, which came in two chunks, and the checks", c do
    assert %{status: :rejected, reason: reason} = refused(c, "arm", %{}, {7.0, 7.25})
    assert reason =~ "; it said: Arming denied: Resolve system health failures first"
    assert reason =~ "; failing checks: check_"
  end

  test "a mode that cannot be: the event came before the acknowledgement", c do
    assert %{status: status, reason: reason} =
             refused(c, "set_mode", %{mode: "POSCTL"}, {115.8, 115.9})

    # On a busy machine it is repeated before the answer comes, and then nobody knows what the first one did.
    assert status in [:rejected, :failed] or reason =~ "a repetition was refused"
    assert reason =~ "; it said: Switching to Position is currently not available"
  end
end
