defmodule MavRouter.SigningTest do
  use ExUnit.Case, async: true
  use Aerie.SigningCase

  alias Aerie.Base.Store
  alias MavRouter.{Link, Router, Signing}
  alias MavCodec.Frame

  @moduletag :tmp_dir
  @moduletag :capture_log
  # When the signed link was recorded.
  @then 1_795_213_682_000_000

  defp count(gateway, what), do: Store.counter(gateway, {:signing, "radio", what})

  defp recorded(c, options \\ []),
    do: start_signing(c.tmp_dir, Keyword.put_new(options, :clock, fn -> @then end))

  describe "the recorded link of an ArduCopter" do
    test "required: what was signed is taken in, nothing else; state comes from verified frames only", c do
      gateway = recorded(c)
      frames = captured("arducopter_signed", @then)
      {signed, unsigned} = Enum.split_with(frames, &Frame.signed?/1)

      # 4,435 unsigned frames: no state, no route, no vehicle.
      assert Signing.admit(gateway, source(), unsigned) == []
      assert Signing.vehicle(gateway, {"main", 1}).state == :rejected
      assert Aerie.Reader.deliver(gateway, source(), unsigned).delivered == 0
      assert Router.routes(gateway) == []
      assert Router.systems(gateway) == %{}

      assert Signing.admit(gateway, source(), signed) == signed

      assert %{state: :verified, verified: verified, unsafe: false, text: "signed"} =
               Signing.vehicle(gateway, {"main", 1})

      assert verified + Signing.vehicle(gateway, {"main", 254}).verified == 6604
      assert count(gateway, :verified) == 6604
      # S3: none of it a second time.
      assert Signing.admit(gateway, source(), signed) == []
    end

    test "with another key nothing is taken in, and that is an alarm, not a storm of them (S9)", c do
      gateway = recorded(c, key_file: key_file(c.tmp_dir, "another"))
      alarms(gateway)
      frames = "arducopter_signed" |> captured(@then) |> Enum.filter(&Frame.signed?/1)
      for read <- Enum.chunk_every(frames, 50), do: assert(Signing.admit(gateway, source(), read) == [])
      assert count(gateway, :rejected) == 6604

      assert_received {:alarm, %{rejected: n},
                       %{system: 1, component: 1, reason: :wrong_signature, link: "radio"}}
                      when n >= 20

      refute_received {:alarm, _, %{system: 1}}
      assert count(gateway, :alarms) == 1
    end

    test "accept_unsigned takes in what has no signature and says loudly that this is unsafe (S11)", c do
      gateway = recorded(c, policy: :accept_unsigned)
      frames = captured("arducopter_signed", @then)
      assert Signing.admit(gateway, source(), frames) == frames
      assert %{unsafe: true, text: "UNSAFE: " <> _} = Signing.vehicle(gateway, {"main", 1})
      assert %{keys: [%{unsafe: true, policy: :accept_unsigned}]} = Signing.list(gateway)
      # A wrong signature is not a missing one.
      {bytes, _} = signed(signer("another"), 1)
      assert Signing.admit(gateway, source(), [frame(bytes)]) == []
    end

    test "off checks nothing and is unsafe", c do
      gateway = recorded(c, policy: :off)
      {bytes, _} = signed(signer("another"), 1)
      assert [_] = Signing.admit(gateway, source(), [frame(bytes)])
      assert %{policy: :off, unsafe: true} = Signing.vehicle(gateway, {"main", 1})

      assert Signing.sign(
               gateway,
               "radio",
               :peer,
               Signing.mark(gateway, {"main", 1}, heartbeat(237, component: 191))
             ) ==
               heartbeat(237, component: 191)
    end
  end

  defp alarms(gateway) do
    test = self()

    :telemetry.attach(
      {gateway, :alarms},
      [:aerie, :signing, :alarm],
      fn _event, measurements, metadata, _ ->
        if metadata.gateway == gateway, do: send(test, {:alarm, measurements, metadata})
      end,
      nil
    )

    on_exit(fn -> :telemetry.detach({gateway, :alarms}) end)
  end

  test "an autopilot with the gateway's own ids is an alarm on a link with keys only if it is signed", c do
    start = &start_parts(Map.put(&1, :mavlink, %{system_id: 245, component_id: 191}), &2)
    gateway = start_signing(c.tmp_dir, [], start)
    own = heartbeat(245, component: 191)
    {forged, _signer} = signed(signer("another"), 245, component: 191)

    for read <- [[own], [forged], [heartbeat(1), own]] do
      frames = Enum.map(read, &frame/1)
      assert Aerie.Reader.deliver(gateway, source(), frames).looped == 1
      assert Router.Echo.alarm(gateway) == nil
    end

    {proved, _signer} = signed(signer(), 245, component: 191)
    assert Aerie.Reader.deliver(gateway, source(), [frame(heartbeat(1)), frame(proved)]).looped == 1
    assert Router.Echo.alarm(gateway) =~ "this gateway's own ids"
  end

  test "without a key nothing is looked at", c do
    gateway = start_parts(%{}, before: [{Signing.Supervisor, []}])
    frames = captured("arducopter_signed")
    assert Signing.admit(gateway, source(), frames) == frames
    assert Signing.mark(gateway, {"main", 1}, "bytes") == "bytes"
    assert Signing.vehicle(gateway, {"main", 1}) == nil
    assert Signing.list(gateway) == %{keys: [], pending: [], not_stored: nil}

    refute File.exists?(Path.join(c.tmp_dir, "signing"))
    # A gateway without that part is none that signs.
    assert Signing.admit(make_ref(), source(), frames) == frames
  end

  test "S7: a radio's RADIO_STATUS needs no signature, and says nothing about being safe", c do
    gateway = start_signing(c.tmp_dir)

    radio =
      frame(MavCodec.encode(%MavCodec.Messages.RadioStatus{rssi: 9}, system: 51, component: 68, version: 1))

    assert Signing.admit(gateway, source(), [radio]) == [radio]
    assert Signing.vehicle(gateway, {"main", 51}).state == :unknown
  end

  test "S7: in the name of the autopilot, or of anybody who signs, it is a forgery and teaches no route", c do
    gateway = start_signing(c.tmp_dir)
    {bytes, _} = MavCodec.Signing.sign(signer(), heartbeat(1, component: 68), 50)

    status = fn component ->
      frame(MavCodec.encode(%MavCodec.Messages.RadioStatus{}, system: 1, component: component))
    end

    assert [_] = Signing.admit(gateway, source(), [status.(68)])
    assert [_] = Signing.admit(gateway, source(), [frame(bytes)])
    assert [] = Signing.admit(gateway, source(), [status.(68), status.(1)])
    Aerie.Reader.deliver(gateway, source(peer: :forger), [status.(1)])
    assert Router.route(gateway, {"main", 1}) == nil
  end

  test "a key of one vehicle is for that one; other networks and systems are not concerned", c do
    gateway = start_signing(c.tmp_dir, system_id: 7)
    others = [frame(heartbeat(8)), frame(heartbeat(255, type: 6, autopilot: 8))]
    seven = frame(heartbeat(7))
    assert Signing.admit(gateway, source(), [seven | others]) == others
    assert Signing.admit(gateway, source(network: "field"), [seven]) == [seven]
    assert [%{key: "main/7"}] = Signing.list(gateway).keys
  end

  test "a secure link and a recording are believed without a signature, but not with a wrong one", c do
    gateway = start_signing(c.tmp_dir)
    plain = frame(heartbeat(1), 5)
    assert Signing.admit(gateway, source(trust: :secure), [plain]) == [plain]
    assert %{state: :unsigned, unsafe: false} = Signing.vehicle(gateway, {"main", 1})
    {bytes, _} = signed(signer("another"), 1)
    assert Signing.admit(gateway, source(trust: :secure), [frame(bytes)]) == []
    assert Signing.admit(gateway, source(trust: :recording), [plain, frame(bytes)]) == [plain, frame(bytes)]
    assert Signing.trust(Link.Spec.parse!("replay:x.tlog")) == :recording
    assert Signing.trust(Link.Spec.parse!("udpin:127.0.0.1:0", options: [secure: true])) == :secure
    assert Signing.trust(Link.Spec.parse!("udpin::0")) == :radio
  end

  test "a key that cannot be read closes the vehicle, and says why", c do
    path = key_file(c.tmp_dir)
    File.chmod!(path, 0o644)

    log =
      ExUnit.CaptureLog.capture_log(fn ->
        gateway = start_signing(c.tmp_dir, key_file: path)
        {bytes, _} = signed(signer(), 1)
        assert Signing.admit(gateway, source(), [frame(bytes), frame(heartbeat(1))]) == []
        assert %{text: "no signature can be checked: " <> text} = Signing.vehicle(gateway, {"main", 1})
        assert text =~ "chmod 600"

        # Repaired.
        File.chmod!(path, 0o600)
        assert Signing.reload(gateway) == [{"main/*", :changed}]
        assert Signing.reload(gateway) == [{"main/*", :same}]
        assert [_] = Signing.admit(gateway, source(), [frame(bytes)])
        File.rm!(path)
        assert [{"main/*", {:error, _}}] = Signing.reload(gateway)
        {bytes, _} = signed(signer(), 2)
        assert [_] = Signing.admit(gateway, source(), [frame(bytes)])
      end)

    assert log =~ "chmod 600"
    refute log =~ passphrase()
  end

  test "keys are in no state that is shown, and in no dump of a table (S9)", c do
    gateway = start_signing(c.tmp_dir)
    {bytes, _} = signed(signer(), 1)
    assert [_] = Signing.admit(gateway, source(), [frame(bytes)])
    key_store = Aerie.Base.Names.whereis(gateway, :key_store)

    tables =
      for {name, table} <- Signing.Tables.of(gateway),
          name not in [:active, :events],
          do: :ets.tab2list(table)

    shown =
      inspect([:sys.get_state(key_store, Aerie.Patience.ms()), tables],
        limit: :infinity,
        printable_limit: :infinity
      )

    erlang =
      :io_lib.format("~p", [[:sys.get_state(key_store, Aerie.Patience.ms()), tables]])
      |> IO.iodata_to_binary()

    key = MavCodec.Signing.key(passphrase())

    for text <- [shown, erlang],
        secret <- [
          passphrase(),
          Base.encode16(key),
          Base.encode16(key, case: :lower),
          inspect(key, base: :decimal),
          key
        ] do
      refute text =~ secret
    end
  end

  describe "what we send" do
    setup c, do: {:ok, gateway: start_signing(c.tmp_dir)}

    test "is signed, with one link id for each link and ever higher time stamps", c do
      own = heartbeat(237, component: 191)

      stamps =
        for _ <- 1..50 do
          marked = Signing.mark(c.gateway, {"main", 1}, own)
          frame = c.gateway |> Signing.sign("radio", :peer, marked) |> IO.iodata_to_binary() |> frame()
          assert {:signed, _} = MavCodec.Signing.check(signer(), frame)
          frame.signature
        end

      assert [0] = stamps |> Enum.map(& &1.link_id) |> Enum.uniq()
      times = Enum.map(stamps, & &1.timestamp)
      assert times == Enum.sort(times) and times == Enum.uniq(times)

      other = Signing.sign(c.gateway, "other", :peer, Signing.mark(c.gateway, {"main", nil}, own))
      assert frame(IO.iodata_to_binary(other)).signature.link_id == 1
      assert count(c.gateway, :signed) == 50
    end

    test "several frames at once are all signed; those of others and of version 1 stay as they are (S10)",
         c do
      own = heartbeat(237, component: 191)
      foreign = heartbeat(255, type: 6, autopilot: 8)
      old = MavCodec.encode(%MavCodec.Messages.Heartbeat{}, system: 237, component: 191, version: 1)
      marked = Signing.mark(c.gateway, {"main", 1}, [own, foreign, old, own])
      bytes = IO.iodata_to_binary(Signing.sign(c.gateway, "radio", :peer, marked))
      {frames, _} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes)
      assert [true, false, false, true] = Enum.map(frames, &Frame.signed?/1)
      assert [_, ^foreign, ^old, _] = Enum.map(frames, & &1.bytes)
      assert count(c.gateway, :not_signed) == 1
      # What is not a frame goes out as it came.
      assert IO.iodata_to_binary(
               Signing.sign(c.gateway, "radio", :peer, Signing.mark(c.gateway, {"main", 1}, "?!"))
             ) ==
               "?!"
    end
  end

  describe "S6: over a restart" do
    defp restart(c, options) do
      gateway = start_signing(c.tmp_dir, options)
      {gateway, fn -> stop_supervised!({Signing.Supervisor, gateway}) end}
    end

    test "time stamps go on where they were, with a clock that stands still", c do
      key = key_file(c.tmp_dir)
      {first, stop} = restart(c, clock: fn -> 0 end, key_file: key)
      {bytes, _} = signed(signer(), 1)
      assert [_] = Signing.admit(first, source(), [frame(bytes)])

      own =
        Signing.sign(first, "radio", :peer, Signing.mark(first, {"main", 1}, heartbeat(237, component: 191)))

      used = frame(IO.iodata_to_binary(own)).signature.timestamp
      assert used > 0
      :ok = Signing.KeyStore.save(first)
      stop.()

      file = Path.join([c.tmp_dir, "signing", "timestamps.json"])
      assert Bitwise.band(File.stat!(file).mode, 0o777) == 0o600
      assert Bitwise.band(File.stat!(Path.dirname(file)).mode, 0o777) == 0o700
      refute File.read!(file) =~ passphrase()

      {second, _} = restart(c, clock: fn -> 0 end, key_file: key)

      own =
        Signing.sign(
          second,
          "radio",
          :peer,
          Signing.mark(second, {"main", 1}, heartbeat(237, component: 191))
        )

      assert frame(IO.iodata_to_binary(own)).signature.timestamp > used
      # S3: what was received before is not received again.
      assert Signing.admit(second, source(), [frame(bytes)]) == []
    end

    test "killed without a chance to write, the next life starts above what was used", c do
      key = key_file(c.tmp_dir)
      {first, _} = restart(c, clock: fn -> 0 end, key_file: key)
      {bytes, _} = signed(signer(), 1)
      assert [_] = Signing.admit(first, source(), [frame(bytes)])
      file = Path.join([c.tmp_dir, "signing", "timestamps.json"])
      # Written by itself, as soon as time stamps were reserved.
      eventually(fn -> File.exists?(file) end)
      key_store = Aerie.Base.Names.whereis(first, :key_store)
      Process.exit(key_store, :kill)

      copy = Path.join(c.tmp_dir, "later")
      File.mkdir_p!(Path.join(copy, "signing"))
      File.cp!(file, Path.join([copy, "signing", "timestamps.json"]))
      second = start_signing(copy, clock: fn -> 0 end, key_file: key)

      own =
        Signing.sign(
          second,
          "radio",
          :peer,
          Signing.mark(second, {"main", 1}, heartbeat(237, component: 191))
        )

      assert frame(IO.iodata_to_binary(own)).signature.timestamp > frame(bytes).signature.timestamp
    end

    test "a damaged file is reported and does not stop anything", c do
      damages = ["{", "[]", ~s({"version":1,"link_ids":{},"links":[1,{"link":2}]})]

      # Each has a folder of its own: a gateway that runs writes into its folder.
      for {damage, n} <- Enum.with_index(damages) do
        dir = Path.join(c.tmp_dir, "#{n}")
        File.mkdir_p!(Path.join(dir, "signing"))
        File.write!(Path.join([dir, "signing", "timestamps.json"]), damage)

        log =
          ExUnit.CaptureLog.capture_log(fn ->
            gateway = start_signing(dir)
            {bytes, _} = signed(signer(), 1)
            assert [_] = Signing.admit(gateway, source(), [frame(bytes)])
          end)

        # Of a file that can be read, entries that cannot be are left out.
        if n < 2, do: assert(log =~ "timestamps.json is damaged")
      end
    end

    @tag :capture_log
    test "a folder that cannot be written is reported, and links go on", c do
      File.write!(Path.join(c.tmp_dir, "signing"), "in the way")
      gateway = start_signing(c.tmp_dir)
      {bytes, _} = signed(signer(), 1)
      assert [_] = Signing.admit(gateway, source(), [frame(bytes)])
      assert {:error, text} = Signing.KeyStore.save(gateway)
      assert Signing.list(gateway).not_stored == text
    end
  end
end
