defmodule SimVehicle.RecordedTest do
  @moduledoc """
  What real firmware was sent in recordings is sent to the simulated vehicle at the same times: the answers, states and
  modes must be the same ones in the same order.
  """

  use ExUnit.Case, async: true

  alias MavCodec.Messages, as: M
  alias SimVehicle.Recording

  @names ["arducopter_flight", "px4_flight", "px4_refusals"]

  # A replay takes a second; every test looks at the same ones.
  setup_all do
    %{
      replays:
        Map.new(@names, fn name ->
          {name, {Recording.load(name), name |> Recording.load() |> Recording.replay()}}
        end)
    }
  end

  for name <- @names do
    describe name do
      setup %{replays: replays} do
        {recording, log} = Map.fetch!(replays, unquote(name))
        %{recording: recording, log: log}
      end

      test "acknowledges every command with the same results, in order and at once", %{
        recording: recording,
        log: log
      } do
        acks = Recording.acks(log)
        assert Enum.map(acks, &tl/1) == Enum.map(recording["acks"], &tl/1)

        for {[at | _ack], [recorded_at | _same]} <- Enum.zip(acks, recording["acks"]) do
          assert_in_delta at, recorded_at, 0.1
        end
      end

      test "is armed, in the modes and in the states of the real one", %{recording: recording, log: log} do
        heartbeats =
          Recording.changes(
            log,
            M.Heartbeat,
            &[Bitwise.band(&1.base_mode, 128), &1.custom_mode, &1.system_status]
          )

        assert Enum.map(heartbeats, &tl/1) == Enum.map(recording["heartbeats"], &tl/1)
      end

      test "lands and takes off as the real one", %{recording: recording, log: log} do
        landed = Recording.changes(log, M.ExtendedSysState, &[&1.landed_state])
        assert Enum.map(landed, &tl/1) == Enum.map(recording["landed"], &tl/1)
      end

      test "reaches the same mission items and reports the same of the mission", %{
        recording: recording,
        log: log
      } do
        reached = Recording.changes(log, M.MissionItemReached, &[&1.seq])
        assert Enum.map(reached, &tl/1) == Enum.map(recording["reached"], &tl/1)
        mission = Recording.changes(log, M.MissionCurrent, &[&1.seq, &1.total, &1.mission_state])
        # An item that is flown for less than a second is seen or not by chance.
        assert Enum.dedup(for [_at, seq | _rest] <- mission, do: seq) ==
                 Enum.dedup(for [_at, seq | _rest] <- recording["mission"], do: seq)

        assert not_active(mission) == not_active(recording["mission"])
      end

      test "accepts and refuses the same plans", %{recording: recording, log: log} do
        acks = for {_at, %M.MissionAck{} = a} <- log, do: [a.type, a.mission_type]
        assert acks == Enum.map(recording["mission_acks"], &tl/1)
      end
    end
  end

  defp not_active(mission),
    do: for([_at, _seq, _total, state] = [_first | rest] when state != 3 <- mission, do: rest)

  test "ArduCopter takes off, flies and lands at the times of the real one", %{replays: replays} do
    {recording, log} = replays["arducopter_flight"]
    landed = Recording.changes(log, M.ExtendedSysState, &[&1.landed_state])

    for {[at, state], [recorded_at, state]} <- Enum.zip(landed, recording["landed"]) do
      assert_in_delta at, recorded_at, 6.0
    end
  end
end
