defmodule MavCodec.SigningModelTest do
  @moduledoc """
  Time stamps and streams as a state machine (S2 to S6): whatever is received, sent and forged, wherever the clock jumps and
  however often the process is killed, `MavCodec.Signing` does as the rules say, in the few lines of a model. What passed once
  passes never again, in later lives neither, with nothing kept but a file that was written whenever `save` was called.
  """
  use ExUnit.Case, async: true

  import :proper_types, only: [vector: 2, oneof: 1, frequency: 1, integer: 2, exactly: 1]

  alias MavCodec.{Messages, Parser, Signing}

  @key :crypto.hash(:sha256, "model")
  @wrong :crypto.hash(:sha256, "wrong")
  @start 1_000_000_000
  @minute 6_000_000

  # What may happen. Times are in units of 10 us; those of frames are relative to our clock.
  defp step do
    frequency([
      {5, {:receive, stream(), offset()}},
      {1, {:forged, stream(), offset()}},
      {2, {:again, integer(0, 40)}},
      {3, :send},
      {2, {:clock, oneof([integer(0, 3_000), near(3_000_000), near(20_000_000), near(-20_000_000)])}},
      {1, :kill}
    ])
  end

  defp stream, do: {integer(0, 1), integer(1, 2), integer(1, 2)}
  defp offset, do: oneof([integer(-500, 500), near(2 * @minute), near(-2 * @minute), exactly(-@minute)])
  defp near(n), do: integer(n - 2, n + 2)

  test "S2, S3, S4, S5, S6: verdicts are the model's, time stamps only go up, nothing passes twice in any life" do
    property = :proper.forall(vector(60, step()), &holds?/1)
    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end

  test "S3: what was accepted after the clock was set back is not accepted again after a crash" do
    {stream, other} = {{1, 1, 2}, {0, 1, 1}}

    assert holds?([
             {:receive, stream, 0},
             {:receive, other, 0},
             # A frame heard while the clock is ahead: it is not read again for 200 s of time stamps.
             {:clock, 20_000_000},
             {:receive, stream, -2 * @minute},
             {:clock, -20_000_000},
             # The file is written, and then the stream runs further ahead than the file says.
             {:receive, other, 2 * @minute},
             {:receive, stream, 2 * @minute},
             :kill
           ])
  end

  defp holds?(steps) do
    clock = :atomics.new(1, signed: true)
    :atomics.put(clock, 1, @start)
    disk = :atomics.new(1, signed: true)

    state = %{
      clock: clock,
      disk: disk,
      signing: life(clock, disk, %{}),
      # What is on the disk besides the time stamp, and whether the clock was set back since.
      file: %{at: nil, streams: %{}},
      back: false,
      # The model: what is remembered of streams, the local time, and what may not be used again.
      streams: %{},
      local: @start,
      sent: 0,
      passed: MapSet.new(),
      frames: []
    }

    Enum.reduce_while(steps, state, fn step, state ->
      case act(step, state) do
        {:ok, state} -> {:cont, stored(state)}
        :wrong -> {:halt, nil}
      end
    end) != nil
  end

  defp life(clock, disk, streams) do
    Signing.new(@key,
      clock: fn -> unix(clock) end,
      stored: :atomics.get(disk, 1),
      save: &save(disk, &1),
      streams: streams
    )
  end

  defp save(disk, stamp) do
    Process.put(:saved, true)
    :atomics.put(disk, 1, stamp)
  end

  defp unix(clock), do: Signing.to_unix(:atomics.get(clock, 1))

  # As the gateway writes its file: after the read in which that was asked for.
  defp stored(state) do
    if Process.delete(:saved) do
      ahead = Signing.ahead(state.signing)

      streams =
        Map.new(Signing.streams(state.signing), fn {stream, last} -> {stream, {last, ahead[stream]}} end)

      %{state | file: %{at: unix(state.clock), streams: streams}, back: false}
    else
      state
    end
  end

  defp act({:clock, by}, state) do
    :atomics.put(state.clock, 1, max(:atomics.get(state.clock, 1) + by, 0))
    {:ok, %{state | back: state.back or by < 0}}
  end

  defp act(:kill, state) do
    stored = :atomics.get(state.disk, 1)

    # A clock that was set back by less than has passed since the file was written cannot be told from one that was not.
    at = if not state.back, do: state.file.at
    streams = Signing.resumed(state.file.streams, stored, {at, unix(state.clock)})
    signing = life(state.clock, state.disk, streams)
    local = max(:atomics.get(state.clock, 1), stored)
    # S5: whoever hears the first frame of the new life, and goes on from there, is not refused.
    heard = Enum.all?(streams, fn {_stream, least} -> least <= local end)
    # S3: nothing of what was accepted in any life is above what its stream has to be above now.
    once = Enum.all?(state.passed, fn {stream, stamp} -> stamp <= Map.get(streams, stream, 0) end)
    right = stored > state.sent and Signing.timestamp(signing) == local and heard and once
    ok(right, %{state | signing: signing, local: local, streams: streams})
  end

  defp act(:send, state) do
    {bytes, signing} = Signing.encode(state.signing, %Messages.Heartbeat{}, system: 237)
    stamp = parse(bytes).signature.timestamp
    right = stamp == max(:atomics.get(state.clock, 1), state.local + 1)
    # Above everything that was ever sent, and below what the next life begins with.
    ok(right and stamp > state.sent and stamp < :atomics.get(state.disk, 1), %{
      state
      | signing: signing,
        local: stamp,
        sent: stamp
    })
  end

  defp act({:receive, stream, offset}, state), do: check(frame(@key, stream, stamp(state, offset)), state)

  defp act({:forged, stream, offset}, state) do
    {verdict, signing} = Signing.check(state.signing, frame(@wrong, stream, stamp(state, offset)))
    # S5: nothing of it is kept.
    ok(verdict == {:rejected, :wrong_signature} and signing == state.signing, state)
  end

  defp act({:again, n}, state) do
    case Enum.at(state.frames, n) do
      nil -> {:ok, state}
      frame -> check(frame, state)
    end
  end

  defp check(frame, state) do
    %{link_id: link, timestamp: stamp} = frame.signature
    stream = {link, frame.system, frame.component}
    expected = verdict(state, stream, stamp)
    {found, signing} = Signing.check(state.signing, frame)
    twice = found == :signed and {stream, stamp} in state.passed

    state =
      if expected == :signed,
        do: %{
          state
          | streams: Map.put(state.streams, stream, stamp),
            local: max(state.local, stamp),
            passed: MapSet.put(state.passed, {stream, stamp})
        },
        else: state

    ok(found == expected and not twice, %{
      state
      | signing: signing,
        frames: Enum.take([frame | state.frames], 40)
    })
  end

  defp verdict(%{streams: streams} = state, stream, stamp) when is_map_key(streams, stream),
    do: if(stamp > state.streams[stream], do: :signed, else: {:rejected, :replayed})

  defp verdict(state, _new, stamp) do
    if stamp + @minute < max(state.local, :atomics.get(state.clock, 1)),
      do: {:rejected, :stale},
      else: :signed
  end

  defp stamp(state, offset), do: max(:atomics.get(state.clock, 1) + offset, 1)

  defp frame(key, {link, system, component}, stamp) do
    # A signer's first time stamp is one above its clock's.
    signer = Signing.new(key, link_id: link, clock: fn -> Signing.to_unix(stamp - 1) end)
    {bytes, _} = Signing.encode(signer, %Messages.Heartbeat{}, system: system, component: component)
    parse(bytes)
  end

  defp parse(bytes) do
    {[frame], _parser} = Parser.push_datagram(Parser.new(), bytes)
    frame
  end

  defp ok(true, state), do: {:ok, state}
  defp ok(false, _state), do: :wrong
end
