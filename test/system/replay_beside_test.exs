defmodule Aerie.System.ReplayBesideTest do
  @moduledoc """
  A replay beside a running gateway of the same checkout and configuration: what is recorded must not come among what the gateway
  publishes, neither while both run nor when the gateway has ended and its folders are free.
  """
  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  @moduletag :tmp_dir
  @flight Path.expand("../../apps/mav_codec/test/fixtures/captures/px4_flight_start.tlog.gz", __DIR__)
  @vehicle "VID-001"

  test "it has NATS and folders of its own", %{tmp_dir: folder} do
    config = config_file(folder, mavlink: %{local_addr: "127.0.0.1:#{free_udp_port()}"})

    gateway = open(["--config", config, "--quiet"])
    await_output(gateway, "", ["connected to NATS at"])
    owners = eventually(fn -> owners(folder) end, "it owns its folders")

    replay = open(["--config", config, "--replay", @flight, "--speed", "max", "--quiet"])

    words = await_output(replay, "", ["connected to NATS at", "link ended"])
    assert words =~ "var/replay/nats/url"
    refute words =~ "in use by another gateway"

    finish(gateway)
    # The status is printed twice a minute.
    words = await_output(replay, "", ["vehicle=#{@vehicle}", "nats=connected"])
    refute words =~ "written again"
    finish(replay)

    assert owners(folder) == owners

    assert {_none, 1} =
             System.cmd("grep", [
               "-r",
               "-a",
               "-l",
               @vehicle,
               Path.join(folder, "nats"),
               Path.join(folder, "outbox")
             ])
  end

  # nil until all are written.
  defp owners(folder) do
    owners = for dir <- ~w(nats outbox ledger audit), do: File.read(Path.join([folder, dir, "owner"]))
    if Enum.all?(owners, &match?({:ok, <<_, _::binary>>}, &1)), do: owners
  end

  defp finish(port) do
    {:os_pid, os_pid} = Port.info(port, :os_pid)
    {_output, 0} = System.cmd("kill", ["-INT", "#{os_pid}"])
    assert await_exit(port) == 0
  end
end
