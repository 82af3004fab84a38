defmodule MavRouter.Signing.SecretsTest do
  @moduledoc "S9: whatever is shown of a running gateway, or said when a part of it crashes, has no key in it."
  use ExUnit.Case, async: true
  use Aerie.SigningCase

  import ExUnit.CaptureLog

  alias Aerie.Base.Secret
  alias Aerie.Base.Names
  alias MavRouter.Signing

  @moduletag :tmp_dir
  @key :binary.copy(<<0xA5, 0x5A>>, 16)

  setup c do
    gateway = start_signing(c.tmp_dir, key_file: key_file(c.tmp_dir, Base.encode16(@key)))
    {_id, _port} = add_link(gateway, "udpin:127.0.0.1:0?secure=true", id: "usb")
    {:ok, _staged} = Signing.KeyStore.stage(gateway, {"main", 1}, Secret.new(@key))
    {:ok, gateway: gateway, link: Names.whereis(gateway, :link, "usb")}
  end

  defp refute_key(text), do: refute_key(text, @key)

  test "states, :sys.get_status, dictionaries and tables of everything that has to do with signing", c do
    {bytes, _} = MavCodec.Signing.sign(MavCodec.Signing.new(@key), heartbeat(1), 50)
    assert [_] = Signing.admit(c.gateway, source(), [frame(bytes)])
    key_store = Names.whereis(c.gateway, :key_store)

    tables =
      for {name, table} <- Signing.Tables.of(c.gateway),
          name not in [:active, :events],
          do: :ets.tab2list(table)

    for term <- [
          tables
          | Enum.flat_map(
              [key_store, c.link],
              &[
                :sys.get_state(&1, Aerie.Patience.ms()),
                :sys.get_status(&1, Aerie.Patience.ms()),
                Process.info(&1)
              ]
            )
        ],
        do: refute_key(shown(term))

    refute_key(shown(Signing.list(c.gateway)))
    refute_key(shown(Signing.vehicle(c.gateway, {"main", 1})))
  end

  test "the report of a link that crashes with the order for a vehicle in its hands", c do
    setup = %MavCodec.Messages.SetupSigning{target_system: 1, secret_key: @key}
    order = {:secret, nil, Secret.new(MavCodec.encode(setup, system: 237))}
    monitor = Process.monitor(c.link)

    log =
      capture_log(fn ->
        # A place that is none: the process fails, and says what its last message was.
        GenServer.cast(c.link, {:send, :nowhere, order})
        assert_receive {:DOWN, ^monitor, :process, _pid, _reason}
      end)

    assert log =~ "nowhere"
    refute_key(log)
  end

  test "the report of a key_store that crashes over a key", c do
    key_store = Names.whereis(c.gateway, :key_store)
    monitor = Process.monitor(key_store)

    log =
      capture_log(fn ->
        catch_exit(GenServer.call(key_store, {:stage, :no_id, Secret.new(@key)}))
        assert_receive {:DOWN, ^monitor, :process, _pid, _reason}
      end)

    assert log =~ "stage"
    refute_key(log)
    # What is in force outlives it.
    eventually(fn -> Names.whereis(c.gateway, :key_store) not in [nil, key_store] end)
    assert Signing.list(c.gateway).pending == ["main/1"]
  end
end
