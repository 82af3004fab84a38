defmodule Aerie.System.SigningKillTest do
  @moduledoc """
  A signed ArduPilot in flight, whose signing clock moves only with the frames that it hears: `kill -9` of the gateway, and
  of the vehicle. The vehicle is heard again at once, because of the gateway's own frames and without another signer.
  """

  use Aerie.RunCase, async: true

  import Aerie.SystemCase

  @moduletag :tmp_dir

  @passphrase "a-passphrase-of-the-system-tests"
  @key MavCodec.Signing.key(@passphrase)
  # Frames of ten seconds, for a busy machine; the half minute that is not in the file would be four thousand.
  @few 1_500

  setup %{tmp_dir: folder} do
    key_file = private_file(folder, "main.key", @passphrase)
    [http, udp] = [free_tcp_port(), free_udp_port()]

    config =
      config_file(folder,
        links: [%{id: "radio", url: "udpin:127.0.0.1:#{udp}"}],
        signing: %{keys: [%{key_file: key_file}]},
        http: %{port: http},
        nats: %{mode: :off}
      )

    %{config: config, http: http, link: "udpout:127.0.0.1:#{udp}"}
  end

  defp fly(link, options \\ []) do
    options = [firmware: :ardupilot, link: link, ready_s: 1.0, key: @key, rates: %{30 => 50}] ++ options
    start_supervised!({SimVehicle, options}, id: make_ref())
  end

  defp signing(http),
    do: with(%{"links" => [%{"signing" => signing}]} <- api(http, "/api/links"), do: signing)

  defp verified?(http, at_least \\ 0) do
    with %{"verified" => verified} = signing when verified > at_least <- signing(http), do: signing
  end

  test "both are heard again", c do
    run = open(["--config", c.config, "--quiet"])
    eventually(fn -> signing(c.http) end, "it runs", started_by())
    fly(c.link)
    # Enough frames that the timestamps in memory are ahead of the file.
    eventually(fn -> verified?(c.http, 300) end, "it is heard")

    kill_9(c.config)
    await_exit(run)
    open(["--config", c.config, "--quiet"])
    signing = eventually(fn -> verified?(c.http) end, "it is heard by the next gateway", started_by())
    assert signing["rejected"] < @few

    stop_supervised!(sim_id())
    %{"rejected" => before, "verified" => verified} = signing(c.http)
    # It returns on another port, with the clock that it stored 40 s ago.
    stored = MavCodec.Signing.timestamp(MavCodec.Signing.new(@key)) - 4_000_000
    fly(c.link, signed_at: stored)
    signing = eventually(fn -> verified?(c.http, verified + 50) end, "it is heard after its own kill")
    assert signing["rejected"] - before < @few
  end

  # The only child is the vehicle.
  defp sim_id do
    {:ok, supervisor} = ExUnit.fetch_test_supervisor()
    [{id, _pid, _type, [SimVehicle]}] = Supervisor.which_children(supervisor)
    id
  end
end
