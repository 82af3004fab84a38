defmodule MavRouter.Signing.RotationTest do
  @moduledoc "Another key for a vehicle, over everything that can happen in between; files and what is in force."
  use ExUnit.Case, async: true
  use Aerie.SigningCase

  alias MavRouter.Signing
  alias MavRouter.Signing.{KeyFiles, KeyStore}

  @moduletag :tmp_dir
  @moduletag :capture_log
  @key {"main", 1}

  setup c do
    key = key_file(c.tmp_dir)
    {:ok, key: key, gateway: start_signing(c.tmp_dir, key_file: key), dir: Path.join(c.tmp_dir, "signing")}
  end

  # Hears one frame of the vehicle, signed by that passphrase.
  defp heard?(gateway, passphrase) do
    {bytes, _} = signed(signer(passphrase), 1)
    Signing.admit(gateway, source(), [frame(bytes, 5)]) != []
  end

  defp stage(gateway, passphrase \\ "new") do
    {:ok, secret} = Signing.Key.parse(passphrase)
    {:ok, _scope} = KeyStore.stage(gateway, @key, secret)
    :ok
  end

  defp keys(gateway), do: for(%{key: key} <- Signing.list(gateway).keys, do: key)

  test "staged, the old key is in force; the first frame under the new one puts that in force, for this vehicle only",
       c do
    :ok = stage(c.gateway)
    assert Signing.list(c.gateway).pending == ["main/1"]
    assert heard?(c.gateway, passphrase())
    assert keys(c.gateway) == ["main/*"]

    assert heard?(c.gateway, "new")
    :ok = KeyStore.settle(c.gateway)
    assert keys(c.gateway) == ["main/1", "main/*"]
    assert Signing.list(c.gateway).pending == []
    refute heard?(c.gateway, passphrase())
    assert heard?(c.gateway, "new")

    {other, _} = signed(signer(), 2)
    assert [_] = Signing.admit(c.gateway, source(), [frame(other)])
  end

  test "all frames of the read whose first one puts the new key in force are heard", c do
    :ok = stage(c.gateway)
    {:ok, secret} = Signing.Key.parse("new")
    {old, _signer} = signed(signer(), 1)

    {frames, _signer} =
      Enum.map_reduce(1..3000, MavCodec.Signing.new(Aerie.Base.Secret.reveal(secret)), fn _n, signer ->
        {bytes, signer} = signed(signer, 1)
        {frame(bytes, 5), signer}
      end)

    assert length(Signing.admit(c.gateway, source(), [frame(old, 5) | frames])) == 3001
    :ok = KeyStore.settle(c.gateway)
    assert keys(c.gateway) == ["main/1", "main/*"]
  end

  test "the key is on the disk before it is sent: after kill -9 the vehicle is still understood, whichever it has",
       c do
    :ok = stage(c.gateway)
    # Another gateway on a copy of the files, as after a kill.
    copy = Path.join(c.tmp_dir, "later")
    File.mkdir_p!(copy)
    copy_dir(c.dir, Path.join(copy, "signing"))
    later = start_signing(copy, key_file: c.key)
    assert Signing.list(later).pending == ["main/1"]
    assert heard?(later, passphrase())
    assert heard?(later, "new")
    :ok = KeyStore.settle(later)
    refute heard?(later, passphrase())

    # And once more: what was proven is what the vehicle has, whatever the configuration says.
    again = Path.join(c.tmp_dir, "again")
    File.mkdir_p!(again)
    copy_dir(Path.join(copy, "signing"), Path.join(again, "signing"))
    again = start_signing(again, key_file: c.key)
    assert heard?(again, "new")
    refute heard?(again, passphrase())
    assert %{source: "enrolment"} = Enum.find(Signing.list(again).keys, &(&1.key == "main/1"))
  end

  test "files are for their owner only, and one that is not is refused", c do
    :ok = stage(c.gateway)
    next = KeyFiles.path(c.dir, @key, :next)
    assert Bitwise.band(File.stat!(next).mode, 0o777) == 0o600
    assert Bitwise.band(File.stat!(Path.dirname(next)).mode, 0o777) == 0o700
    assert Bitwise.band(File.stat!(c.dir).mode, 0o777) == 0o700

    assert heard?(c.gateway, "new")
    :ok = KeyStore.settle(c.gateway)
    refute File.exists?(next)
    current = KeyFiles.path(c.dir, @key, :current)
    File.chmod!(current, 0o640)
    assert {"main/1", {:error, text}} = List.keyfind(Signing.reload(c.gateway), "main/1", 0)
    assert text =~ "chmod 600"
    # The one that was read stays.
    assert heard?(c.gateway, "new")
  end

  test "generate makes one key until it is proven; previous is the one before; discard and retire", c do
    assert {:ok, one} = KeyStore.stage(c.gateway, @key, :generate)
    assert {:ok, same} = KeyStore.stage(c.gateway, @key, :generate)
    assert Signing.Key.same?(one.secret, same.secret)

    assert {:error, %{reason: {:invalid, "there is no earlier key: " <> _}}} =
             KeyStore.stage(c.gateway, @key, :previous)

    :ok = Aerie.Vehicle.Enrolment.discard(c.gateway, @key)
    assert Signing.list(c.gateway).pending == []

    :ok = stage(c.gateway, "first")
    assert heard?(c.gateway, "first")
    :ok = KeyStore.settle(c.gateway)
    :ok = stage(c.gateway, "second")
    assert heard?(c.gateway, "second")
    :ok = KeyStore.settle(c.gateway)
    refute heard?(c.gateway, "first")
    assert {:ok, _} = KeyStore.stage(c.gateway, @key, :previous)
    assert heard?(c.gateway, "first")
    :ok = KeyStore.settle(c.gateway)
    refute heard?(c.gateway, "second")

    :ok = KeyStore.retire(c.gateway, @key)
    assert keys(c.gateway) == ["main/*"]
    assert heard?(c.gateway, passphrase())
  end

  test "a key from the configuration is replaced in its file: reload, without a restart and without losing the time",
       c do
    {bytes, signer} = signed(signer(), 1)
    assert [_] = Signing.admit(c.gateway, source(), [frame(bytes)])
    before = stamp(c.gateway)
    File.write!(c.key, "rotated")
    assert Signing.reload(c.gateway) == [{"main/*", :changed}]
    {bytes, _} = signed(signer, 1)
    assert Signing.admit(c.gateway, source(), [frame(bytes)]) == []
    assert heard?(c.gateway, "rotated")
    assert stamp(c.gateway) > before
  end

  defp stamp(gateway) do
    marked = Signing.mark(gateway, {"main", 1}, heartbeat(237, component: 191))
    frame(IO.iodata_to_binary(Signing.sign(gateway, "radio", :peer, marked))).signature.timestamp
  end

  test "without any key configured, a vehicle that was given one needs it from then on" do
    dir = Path.join(System.tmp_dir!(), "aerie-none-#{System.unique_integer([:positive])}")
    on_exit(fn -> File.rm_rf!(dir) end)
    gateway = start_parts(%{signing: %{keys: [], dir: dir}}, before: [{Signing.Supervisor, []}])
    plain = frame(heartbeat(1))
    assert Signing.admit(gateway, source(), [plain]) == [plain]
    :ok = stage(gateway)
    # Not proven: what it sends is still what there is.
    assert Signing.admit(gateway, source(), [plain]) == [plain]
    assert heard?(gateway, "new")
    :ok = KeyStore.settle(gateway)
    assert Signing.admit(gateway, source(), [plain]) == []
    assert %{policy: :required, state: :verified, rejected: 1} = Signing.vehicle(gateway, @key)
  end

  describe "while somebody waits for the proof" do
    setup c do
      {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0?secure=true", id: "usb")
      {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}])
      {:ok, port: port, socket: socket}
    end

    defp say(c, bytes), do: :ok = :gen_udp.send(c.socket, {127, 0, 0, 1}, c.port, bytes)

    # The order to take a key, as the vehicle gets it; other frames for it come in between.
    defp order(c) do
      assert_receive {:udp, _socket, _from, _port, bytes}
      {frames, _} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes)
      Enum.find(frames, &(&1.id == 256)) || order(c)
    end

    test "the old key's frames prove nothing, whenever they come; the error says that the vehicle still has it",
         c do
      {bytes, signer} = signed(signer(), 1)
      say(c, bytes)
      eventually(fn -> MavRouter.Router.route(c.gateway, @key) end)
      {setup_signing, error} = enrolled_in_vain(c, signer)
      # Signed with the key in force.
      assert {:signed, _} = MavCodec.Signing.check(signer, setup_signing)
      assert Exception.message(error) =~ "it still signs with its former key"
      assert Signing.list(c.gateway).pending == ["main/1"]

      # It had taken it after all.
      {:ok, %{secret_key: key}} = MavCodec.decode(setup_signing)
      {bytes, _} = MavCodec.Signing.sign(MavCodec.Signing.new(key), heartbeat(1), 50)
      say(c, bytes)
      eventually(fn -> Signing.list(c.gateway).pending == [] end)
      assert "main/1" in keys(c.gateway)
    end

    # On a busy machine two seconds may be over before anything of the vehicle was heard: then once more.
    defp enrolled_in_vain(c, signer) do
      task =
        Task.async(fn ->
          Aerie.Vehicle.Enrolment.enrol(c.gateway, @key, key: :generate, timeout_ms: 2_000)
        end)

      setup_signing = order(c)
      assert {:error, %Aerie.Base.Error{} = error} = says_until_done(task, c, signer)

      if Exception.message(error) =~ "nothing from component",
        do: enrolled_in_vain(c, signer),
        else: {setup_signing, error}
    end

    # Signed frames, from now until the answer is there.
    defp says_until_done(task, c, signer) do
      {bytes, signer} = signed(signer, 1)
      say(c, bytes)
      with nil <- Task.yield(task, 20), do: says_until_done(task, c, signer), else: ({:ok, answer} -> answer)
    end

    test "another component of the vehicle proves nothing either", c do
      {bytes, signer} = signed(signer(), 1)
      say(c, bytes)
      eventually(fn -> MavRouter.Router.route(c.gateway, @key) end)
      task = Task.async(fn -> Aerie.Vehicle.Enrolment.revoke(c.gateway, @key, timeout_ms: 400) end)
      order(c)
      # A camera that never signs.
      for n <- 1..5, do: say(c, heartbeat(1, component: 100, autopilot: 8, seq: n))
      {bytes, _} = signed(signer, 1)
      say(c, bytes)

      assert {:error, %{reason: {:unavailable, "no unsigned frame came on link usb" <> _}}} =
               Task.await(task, Aerie.Patience.ms())
    end

    test "a second one who asks is told; an armed vehicle is left alone; a key itself is no argument", c do
      {bytes, _signer} = signed(signer(), 1)
      say(c, bytes)
      eventually(fn -> MavRouter.Router.route(c.gateway, @key) end)
      patience = Aerie.Patience.ms()

      task =
        Task.async(fn ->
          Aerie.Vehicle.Enrolment.enrol(c.gateway, @key, key: :generate, timeout_ms: patience)
        end)

      {:ok, %{secret_key: key}} = MavCodec.decode(order(c))

      assert {:error, %{reason: {:conflict, "another enrolment of this vehicle is in progress"}}} =
               Aerie.Vehicle.Enrolment.enrol(c.gateway, @key)

      # The first one's goes on, until the vehicle proves that it has the key.
      {bytes, _} = MavCodec.Signing.sign(MavCodec.Signing.new(key), heartbeat(1), 50)
      say(c, bytes)
      assert {:ok, %{key: %Aerie.Base.Secret{}}} = Task.await(task, patience)

      assert {:error, %{reason: {:invalid, "key is {:file, " <> _}}} =
               Aerie.Vehicle.Enrolment.enrol(c.gateway, @key, key: "a passphrase")

      assert {:error, %Aerie.Base.Error{} = error} = Aerie.Vehicle.Enrolment.enrol(c.gateway, :vid_007)
      assert Exception.message(error) =~ ~s(like "VID-007")

      armed = %{id: "VID-001", key: @key, groups: %{mode: %{data: %{armed: true}}}}
      :ok = Aerie.Base.Store.put_vehicle(c.gateway, @key, armed)
      assert {:error, %Aerie.Base.Error{} = error} = Aerie.Vehicle.Enrolment.enrol(c.gateway, @key)
      assert Exception.message(error) =~ "is armed"
    end
  end
end
