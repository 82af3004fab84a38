defmodule Aerie.System.ReloadTest do
  @moduledoc "A changed configuration is put in force while a vehicle flies; links that are the same are not touched."

  use Aerie.SystemCase, async: true

  alias Aerie.Base.{Names, Store}
  alias Aerie.Reload
  alias MavRouter.Link

  @moduletag :tmp_dir
  @moduletag :capture_log

  defp write(file, links, more \\ "") do
    list = Enum.map_join(links, "\n", fn {id, url} -> "  - {id: #{id}, url: \"#{url}\"}" end)
    File.write!(file, "links:\n#{list}\nclients: []\n#{more}")
  end

  defp start(dir, links) do
    file = Path.join(dir, "gateway.yaml")
    write(file, links)

    # What the file does not name stands on the command line, as far as the test is concerned; the links are the file's.
    run = start_gateway(dir, config_file: file, without: ["links"])
    {run.gateway, file}
  end

  test "links are added, changed and removed; the others keep their processes, and errors change nothing", %{
    tmp_dir: dir
  } do
    [keep, change, drop, more] = for _n <- 1..4, do: "udpin:127.0.0.1:#{free_udp_port()}"
    {gateway, file} = start(dir, keep: keep, change: change, drop: drop)
    port = link_port(gateway, "keep")
    start_supervised!({SimVehicle, [link: "udpout:127.0.0.1:#{port}"] ++ fast_vehicle(:px4)})
    eventually(fn -> data(gateway, :mode)[:mode] end, "the vehicle is heard")
    processes = fn -> Map.new(~w(keep change), &{&1, Names.whereis(gateway, :link, &1)}) end
    before = processes.()

    # An error anywhere: nothing changes.
    write(file, [keep: keep], "http: {prot: 1}\n")
    assert {:error, [line]} = Reload.run(gateway, "test")
    assert line =~ "prot" and line =~ "gateway.yaml"
    assert processes.() == before
    assert Store.link(gateway, "drop")

    other = "udpin:127.0.0.1:#{free_udp_port()}"
    write(file, [keep: keep, change: other, more: more], "timeouts: {link_idle_s: 7}\n")
    assert {:ok, report} = Reload.run(gateway, "test")
    assert report.links == %{added: ["more"], removed: ["drop"], changed: ["change"]}
    assert report.clients == %{added: [], removed: [], changed: []}
    assert report.needs_restart == ["timeouts.link_idle_s"]
    assert report.failed == []
    assert link_port(gateway, "more")
    assert Store.link(gateway, "drop") == nil
    assert Store.link(gateway, "change").url =~ other
    assert processes.()["keep"] == before["keep"]
    assert processes.()["change"] != before["change"]
    heard = Store.vehicle(gateway, {"main", 1}).last_heard
    eventually(fn -> Store.vehicle(gateway, {"main", 1}).last_heard > heard end, "the vehicle is still heard")

    # Again, without a difference.
    assert {:ok, %{links: %{added: [], removed: [], changed: []}}} = Reload.run(gateway, "test")
  end

  test "what cannot be opened is named, the rest is in force, and the next time it is tried again", %{
    tmp_dir: dir
  } do
    {:ok, taken} = :gen_udp.open(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(taken)
    keep = "udpin:127.0.0.1:#{free_udp_port()}"
    {gateway, file} = start(dir, keep: keep)
    write(file, keep: keep, taken: "udpin:127.0.0.1:#{port}", fine: "udpin:127.0.0.1:#{free_udp_port()}")
    assert {:ok, %{failed: [%{what: "taken", reason: reason}]}} = Reload.run(gateway, "test")
    assert reason =~ "in use"
    assert link_port(gateway, "fine")
    assert Link.get(gateway, "taken") == nil
    :gen_udp.close(taken)
    assert {:ok, %{failed: [], links: %{added: ["taken"]}}} = Reload.run(gateway, "test")
    assert link_port(gateway, "taken") == port
  end
end
