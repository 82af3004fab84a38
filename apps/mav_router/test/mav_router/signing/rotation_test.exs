defmodule MavRouter.Signing.RotationTest do
  @moduledoc "Another key for a vehicle, over everything that can happen in between; files and what is in force."
  use ExUnit.Case, async: true
  use Aerie.SigningCase

  alias MavRouter.Signing
  alias MavRouter.Signing.KeyStore.KeyFiles
  alias MavRouter.Signing.KeyStore

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

    :ok = KeyStore.discard(c.gateway, @key)
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
end
