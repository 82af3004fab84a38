defmodule Msp.RerunTest do
  @moduledoc "What went over a line is recorded, and gives the same bytes again; and it can be read."
  use ExUnit.Case, async: true

  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.Frame
  alias MavCodec.Tlog
  alias Msp.{Listing, Rerun}
  alias Msp.Test.{Line, Recorded, Simulated}

  @second 1_000_000

  defp answers(firmware) do
    {answer, _change, _state} = Simulated.controller(firmware)
    fn bytes, us -> with("" <- answer.(bytes, us), do: nil) end
  end

  defp mavlink(line, message, seconds) do
    bytes = MavCodec.encode(message, system: 237, component: 191)
    line |> Line.handle({:mavlink, bytes}) |> Line.run(round(seconds * @second))
  end

  # Everything that the session can be given.
  defp busy(firmware) do
    name = if firmware == :inav, do: "nav_rth_altitude", else: "BF_ROLL_P"
    to = [target_system: 42, target_component: 1]

    answers(firmware)
    |> Line.open(record: true)
    |> Line.run(7 * @second)
    |> mavlink(struct!(M.ParamRequestList, to), 3)
    |> mavlink(struct!(M.ParamSet, [param_id: name, param_value: 40.0, param_type: 9] ++ to), 1)
    |> mavlink(struct!(M.MissionRequestList, to), 1)
    |> mavlink(struct!(M.CommandLong, [command: 241, param5: 1.0] ++ to), 1)
    |> Line.handle({:client, 1, :up})
    |> Line.handle({:client, 1, Frame.encode(%Frame{id: 112}) |> IO.iodata_to_binary()})
    |> Line.handle({:client, 1, Frame.encode(%Frame{id: 250}) |> IO.iodata_to_binary()})
    |> Line.run(@second)
    |> Line.handle({:client, 1, :down})
    |> Line.run(@second)
    |> Line.handle({:bytes, "noise$M>" <> <<200>>})
    |> Line.run(3 * @second)
  end

  # Through the format of the file, in which times of day stand before the frames.
  defp recording(line) do
    frames = line.recorded |> Enum.reverse() |> Enum.map(&%{&1 | at: 1_700_000_000_000_000})
    bytes = frames |> Tlog.records(signatures: false) |> IO.iodata_to_binary()
    {items, decoder} = Tlog.Decoder.push(Tlog.Decoder.new(), bytes)
    assert Tlog.Decoder.finish(decoder) == []
    items
  end

  defp rerun(frames), do: Enum.reduce(frames, Rerun.new(42), &elem(Rerun.push(&2, &1), 1))

  for firmware <- [:betaflight, :inav] do
    test "#{firmware}: the same writes and MAVLink frames, byte for byte" do
      line = busy(unquote(firmware))
      assert %{difference: nil, counts: counts, told: "", written: ""} = rerun(recording(line))
      assert counts.writes == length(line.written)
      assert counts.frames == length(Line.told(line))
      assert counts.writes > 200 and counts.frames > 300
    end
  end

  test "also real flight controllers' answers" do
    for name <- ~w(betaflight_4.5.5 inav_9.0.0) do
      line = name |> Recorded.answers(0.0) |> Line.open(record: true) |> Line.run(10 * @second)
      assert %{difference: nil, counts: %{frames: frames}} = rerun(recording(line))
      assert frames > 50
    end
  end

  test "a byte that is another one, and a frame that is missing, are found" do
    frames = :betaflight |> answers() |> Line.open(record: true) |> Line.run(3 * @second) |> recording()
    position = Enum.find_index(frames, &(&1.id == M.Heartbeat.id()))
    other = Enum.find_index(frames, &(&1.id == M.Attitude.id()))
    swapped = List.replace_at(frames, position, Enum.at(frames, other))
    assert %{difference: %{what: :frame, recorded: recorded, here: here}} = rerun(swapped)
    assert recorded == Enum.at(frames, other).bytes
    assert byte_size(here) == byte_size(recorded)
    assert %{difference: %{what: :frame}} = rerun(List.delete_at(frames, position))
  end

  test "what began in the midst is not compared; a line that is opened again is" do
    frames = :inav |> answers() |> Line.open(record: true) |> Line.run(3 * @second) |> recording()

    assert %{session: nil, difference: nil, counts: %{entries: entries, frames: 0}} =
             rerun(Enum.drop(frames, 40))

    assert entries > 20
    assert %{difference: nil, counts: %{frames: frames_again}} = rerun(Enum.drop(frames, 40) ++ frames)
    assert frames_again > 20
    # Of another vehicle on the link, or on its way to this one.
    assert %{counts: %{entries: 0}} = Enum.reduce(frames, Rerun.new(7), &elem(Rerun.push(&2, &1), 1))
  end

  test "the listing names messages and reads their values by the firmware that answered" do
    lines = :betaflight |> busy() |> recording() |> listed()

    assert [%{what: :opened}, %{from: :gateway, what: :request, name: "API_VERSION"} | _] = lines
    assert %{values: %{api_major: 1, api_minor: 46}} = find(lines, :vehicle, :reply, "API_VERSION")
    assert %{values: %{roll: _, pitch: _}} = find(lines, :vehicle, :reply, "ATTITUDE")
    assert %{values: %{param_id: "BF_ROLL_P"}} = find(lines, :gateway, :mavlink, "PARAM_SET")
    assert %{values: %{}} = find(lines, 1, :request, "PID")
    assert for(%{from: 1, what: what} <- lines, what != :request, do: what) == [:joined, :allowed, :left]
  end

  test "before the firmware is known, a message has its payload" do
    lines =
      :inav
      |> answers()
      |> Line.open(record: true)
      |> Line.run(3 * @second)
      |> recording()
      |> Enum.drop(60)
      |> listed()

    assert %{values: nil, payload: <<_, _::binary>>} = find(lines, :vehicle, :reply, "ATTITUDE")
    refute find(lines, :vehicle, :reply, "API_VERSION")
  end

  defp listed(frames) do
    {lines, _state} =
      Enum.flat_map_reduce(frames, {Rerun.new(42), Listing.new()}, fn frame, {rerun, listing} ->
        case Rerun.push(rerun, frame) do
          {nil, rerun} ->
            {[], {rerun, listing}}

          {entry, rerun} ->
            {lines, listing} = Listing.lines(listing, entry)
            {lines, {rerun, listing}}
        end
      end)

    lines
  end

  defp find(lines, from, what, name),
    do: Enum.find(lines, &match?(%{from: ^from, what: ^what, name: ^name}, &1))
end
