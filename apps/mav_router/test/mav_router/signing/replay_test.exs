defmodule MavRouter.Signing.ReplayTest do
  @moduledoc "What was heard once is not heard again: on the same link, on another, after a restart, after a kill (S3, S4, S6)."
  use ExUnit.Case, async: true
  use Aerie.SigningCase

  alias MavRouter.Signing

  @moduletag :tmp_dir
  @moduletag :capture_log
  @now 1_795_213_682_000_000

  # Frames of the vehicle, one every so many microseconds from @now on.
  defp recorded(n, step_us) do
    {frames, _} =
      Enum.map_reduce(1..n, nil, fn i, _ ->
        signer = signer(passphrase(), clock: fn -> @now + i * step_us end)
        {bytes, _} = signed(signer, 1, seq: rem(i, 256))
        {frame(bytes, @now + i * step_us), nil}
      end)

    frames
  end

  # In an atomic, which outlives the test's process.
  defp clock(at) do
    clock = :atomics.new(1, signed: true)
    :atomics.put(clock, 1, at)
    clock
  end

  defp start(c, clock, options \\ []) do
    start_signing(c[:dir] || c.tmp_dir, Keyword.merge([clock: fn -> :atomics.get(clock, 1) end], options))
  end

  defp heard(gateway, frames, link \\ "radio"),
    do: Enum.count(frames, &(Signing.admit(gateway, source(id: link), [&1]) != []))

  test "S3: by the same link nothing a second time, in whatever order", c do
    gateway = start(c, clock(@now))
    frames = recorded(50, 100_000)
    assert heard(gateway, frames) == 50
    assert heard(gateway, Enum.shuffle(frames)) == 0
  end

  test "S5: a vehicle whose clock is 45 years ahead is heard and named, and shuts nobody out", c do
    gateway = start(c, clock(@now))
    {wrong, _} = passphrase() |> signer(clock: fn -> @now + 1_420_070_400_000_000 end) |> signed(9)

    log =
      ExUnit.CaptureLog.capture_log(fn -> assert heard(gateway, [frame(wrong, @now)]) == 1 end)

    assert log =~ "the signing clock of 9/1 is 45.0 years ahead of this machine's"
    assert heard(gateway, recorded(5, 100_000)) == 5
    assert heard(gateway, recorded(6, 100_000), "other") == 6

    # What we send is not signed with that time, which others would follow.
    tables = Signing.Tables.of(gateway)
    sent = Signing.Verifiers.timestamp(tables, "radio", Signing.Tables.scope(tables, {"main", 1}))
    assert_in_delta sent, div(@now, 10) - 142_007_040_000_000, 60_000_000
  end

  test "by another link of the network: what is late is a radio, what is old is a replay", c do
    gateway = start(c, clock(@now))
    frames = recorded(600, 100_000)
    assert heard(gateway, Enum.take(frames, 300)) == 300
    # A redundant radio that is five seconds slower.
    assert heard(gateway, Enum.slice(frames, 250, 50), "slow") == 50
    assert heard(gateway, Enum.drop(frames, 300)) == 300
    # Recorded by a third one, played half a minute later; the minute of S4 would let it pass.
    assert heard(gateway, Enum.slice(frames, 250, 100), "forger") == 0
    # Nor does it help to begin with a fresh one and then to dawdle.
    assert heard(gateway, [List.last(frames)], "forger") == 1
    assert heard(gateway, Enum.slice(frames, 250, 100), "forger") == 0
    # By a link of high latency half a minute is normal.
    slow = fn frame -> Signing.admit(gateway, source(id: "satellite", high_latency: true), [frame]) != [] end
    assert slow.(Enum.at(frames, 298))
    # The vehicle itself is not hindered by any of this.
    signer = signer(passphrase(), clock: fn -> @now + 61_000_000 end)
    {bytes, _} = signed(signer, 1)
    assert heard(gateway, [frame(bytes)], "slow") == 1
  end

  test "the clock jumps back by years: time stamps go on, in and out", c do
    clock = clock(@now)
    gateway = start(c, clock)
    [first | later] = recorded(10, 100_000)
    assert heard(gateway, [first]) == 1
    last = stamp(gateway)
    :atomics.put(clock, 1, 0)
    assert stamp(gateway) == last + 1
    assert heard(gateway, later) == 9
    # S5: above everything that was heard.
    assert stamp(gateway) > List.last(later).signature.timestamp
  end

  defp stamp(gateway) do
    marked = Signing.mark(gateway, {"main", 1}, heartbeat(237, component: 191))
    frame(IO.iodata_to_binary(Signing.sign(gateway, "radio", :peer, marked))).signature.timestamp
  end

  describe "after kill -9" do
    # The file is of the first frame; another minute was heard, which is not in it.
    setup c do
      clock = clock(@now)
      key = key_file(c.tmp_dir)
      gateway = start(c, clock, key_file: key)
      frames = recorded(280, 100_000)
      assert heard(gateway, [hd(frames)]) == 1
      :ok = Signing.KeyStore.save(gateway)
      dir = Path.join(c.tmp_dir, "killed")
      File.mkdir_p!(dir)
      copy_dir(Path.join(c.tmp_dir, "signing"), Path.join(dir, "signing"))
      assert heard(gateway, tl(frames)) == 279
      {:ok, clock: clock, frames: frames, again: [dir: dir, tmp_dir: dir], key: key}
    end

    test "what was heard before it is not heard again; what comes now is", c do
      # 28 s later.
      clock = clock(@now + 28_100_000)
      gateway = start(Map.new(c.again), clock, key_file: c.key)
      assert heard(gateway, c.frames) == 0
      {bytes, _} = signed(signer(passphrase(), clock: fn -> @now + 28_600_000 end), 1)
      assert heard(gateway, [frame(bytes)]) == 1
      assert heard(gateway, c.frames) == 0
    end

    test "nor by another link", c do
      gateway = start(Map.new(c.again), clock(@now + 28_100_000), key_file: c.key)
      assert heard(gateway, Enum.take(c.frames, 150), "slow") == 0
    end

    test "nor without a clock that tells how long ago it was: above all that can have been heard", c do
      gateway = start(Map.new(c.again), clock(0), key_file: c.key)
      assert heard(gateway, c.frames) == 0
    end

    test "a vehicle whose time stood still meanwhile is heard again when it has heard us", c do
      gateway = start(Map.new(c.again), clock(@now + 3_600_000_000), key_file: c.key)
      vehicle = signer(passphrase(), clock: fn -> @now + 1_000_000 end)
      {soon, vehicle} = signed(vehicle, 1)
      assert heard(gateway, [frame(soon)]) == 0
      marked = Signing.mark(gateway, {"main", 1}, heartbeat(237, component: 191))
      ours = frame(IO.iodata_to_binary(Signing.sign(gateway, "radio", :peer, marked)))
      assert {:signed, vehicle} = MavCodec.Signing.check(vehicle, ours)
      {now, _} = signed(vehicle, 1)
      assert heard(gateway, [frame(now)]) == 1
    end
  end
end
