defmodule Protocols.Mission.UploadTest do
  use ExUnit.Case, async: true

  alias MavCodec.Messages, as: M
  alias Protocols.Mission.Upload

  @gcs {255, 190}
  @other {254, 190}
  @rules %{again_us: 1_000, patience_us: 5_000, out_of_turn: :ask}

  defp handle({upload, _actions}, event, now, rules \\ @rules), do: Upload.handle(upload, event, rules, now)

  defp begun(count, rules \\ @rules),
    do: handle({nil, []}, {:count, %M.MissionCount{count: count}, @gcs}, 0, rules)

  defp item(seq), do: {:item, %M.MissionItemInt{seq: seq}, @gcs}
  defp asked({_upload, actions}), do: for({:send, %M.MissionRequestInt{seq: seq}} <- actions, do: seq)

  test "items are requested one after the other, and stored when all are there (W3)" do
    assert [0] = asked(begun = begun(2))
    assert [1] = asked(first = handle(begun, item(0), 10))
    assert {%{items: :storing}, [store: [%{seq: 0}, %{seq: 1}]]} = last = handle(first, item(1), 20)

    # The station waits: the last item is requested again, and coming again it changes nothing.
    assert [1] = asked(again = handle(last, :tick, 2_000))
    assert {%{items: :storing}, []} = handle(again, item(1), 2_010)
    assert [1] = asked(handle(again, :tick, 60_000))
  end

  test "an item that does not come is requested again, until it is given up (W1)" do
    assert {_upload, []} = begun = handle(begun(2), :tick, 1_000)
    assert [0] = asked(again = handle(begun, :tick, 1_001))
    assert {_upload, []} = handle(again, :tick, 2_001)
    assert [0] = asked(handle(again, :tick, 5_000))

    assert {nil, [send: %M.MissionAck{type: 15, target_system: 255, target_component: 190}]} =
             handle(again, :tick, 5_001)
  end

  test "an item that was not requested" do
    for {rule, before, later} <- [{:ask, [1], [1]}, {:ask_unless_repeated, [], [1]}, {:refuse, [], []}] do
      rules = %{@rules | out_of_turn: rule}
      first = handle(begun(3, rules), item(0), 10, rules)
      assert {rule, asked(handle(first, item(0), 20, rules))} == {rule, before}
      assert {rule, asked(late = handle(first, item(2), 20, rules))} == {rule, later}
      if rule == :refuse, do: assert({%{next: 1}, [send: %M.MissionAck{type: 13}]} = late)
    end
  end

  test "what belongs to no upload; ArduPilot's request" do
    assert {nil, [:stray]} = handle({nil, []}, item(0), 0)
    {:item, item, _from} = item(0)
    assert {%{next: 0}, [:stray]} = handle(begun(2), {:item, item, @other}, 0)
    assert {%{next: 0}, [:stray]} = handle(begun(2), {:item, %{item | mission_type: 1}, @gcs}, 0)

    assert {_upload, [send: %M.MissionRequest{seq: 0}]} =
             begun(2, Map.put(@rules, :request, M.MissionRequest))
  end

  test "only the station that began ends it, and not while it is stored (W6)" do
    assert {nil, []} = handle(begun(2), {:cancelled, @gcs}, 10)
    assert {%Upload{}, []} = handle(begun(2), {:cancelled, @other}, 10)
    assert {%Upload{}, []} = begun(1) |> handle(item(0), 10) |> handle({:cancelled, @gcs}, 20)
  end

  test "another station may begin when the first one is silent, and nobody while a plan is stored" do
    {upload, _actions} = begun(1)
    assert Upload.busy(nil, @gcs, @rules, 0) == nil
    assert Upload.busy(upload, @gcs, @rules, 10) == nil
    assert Upload.busy(upload, @other, @rules, 5_000) == :other
    assert Upload.busy(upload, @other, @rules, 5_001) == nil
    {storing, _actions} = Upload.handle(upload, item(0), @rules, 10)
    assert Upload.busy(storing, @gcs, @rules, 60_000) == :storing
  end
end
