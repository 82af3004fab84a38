defmodule Aerie.System.NatsSetupTest do
  @moduledoc """
  Two hubs and a vehicle with the files that `aerie nats-setup` writes, as they are: who is shown, who commands, and who is refused once it was
  taken out or its key was lost.
  """

  use Aerie.SystemCase, async: true

  alias Aerie.{CommandCase, Fleet, HubServer}
  alias Aerie.Control.Commands
  alias Aerie.Fleet.Bridge

  @moduletag :tmp_dir
  @moduletag :capture_log
  @vehicle "VID-001"

  # The files as they were copied, named from elsewhere: a gateway of a test does not run in their folder.
  defp copied(set, folder, dir) do
    File.mkdir_p!(Path.dirname(dir))
    File.cp_r!(Path.join(set, folder), dir)
    file = Path.join(dir, "gateway.yaml")
    text = Regex.replace(~r/: (leaf\.nk|gateway\.nk|ca\.pem)$/m, File.read!(file), ": #{dir}/\\1")
    Aerie.Base.Files.Private.write(file, text)
    file
  end

  defp start_hub(set, folder, dir) do
    overrides = %{"nats" => %{"retry_max_ms" => 1_000}, "remote" => %{"lost_s" => 20, "announce_s" => 0.5}}
    start_gateway(dir, config_file: copied(set, folder, Path.join(dir, "etc")), overrides: overrides).gateway
  end

  defp start_vehicle(set, dir) do
    %{gateway: gateway} =
      start_gateway(dir,
        links: ["udpin:127.0.0.1:0"],
        config_file: copied(set, "vehicles/#{@vehicle}", Path.join(dir, "etc")),
        overrides: %{"remote" => %{"announce_s" => 0.5}, "timeouts" => patient()}
      )

    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    sim = start_supervised!({SimVehicle, [link: link] ++ fast_vehicle(:ardupilot)})
    SimVehicle.await(sim, & &1.ready)
    %{gateway: gateway, sim: sim}
  end

  defp command(hub, mode, id) do
    {:ok, result} =
      Commands.submit(hub,
        id: id,
        vehicle: @vehicle,
        type: "set_mode",
        params: %{mode: mode},
        deadline: System.os_time(:second) + 120
      )

    result
  end

  defp completed(hub, mode) do
    eventually(
      fn -> command(hub, mode, Aerie.Vehicle.Command.id()).status == :completed end,
      fn -> "it is commanded: #{inspect(command(hub, mode, Aerie.Vehicle.Command.id()))}" end
    )
  end

  defp refused(info), do: info[:problem] && info.problem =~ ~r/authoriz/i

  test "both hubs show and command it; the one that is removed is refused, and a lost key opens nothing", %{
    tmp_dir: dir
  } do
    server = HubServer.start(dir, [@vehicle])
    set = server.set
    HubServer.change(server, %{hubs: ["tower"]})
    HubServer.signal(server, "HUP")
    %{gateway: aboard, sim: sim} = start_vehicle(set, Path.join(dir, "aboard"))
    first = start_hub(set, "hub", Path.join(dir, "first"))
    tower = start_hub(set, "hubs/tower", Path.join(dir, "tower"))

    for {hub, mode} <- [{first, "LOITER"}, {tower, "GUIDED"}] do
      eventually(
        fn -> match?(%{via: "gateway-VID-001", status: :online}, Fleet.vehicle(hub, @vehicle)) end,
        "it is shown"
      )

      completed(hub, mode)
      assert SimVehicle.state(sim).mode == mode
    end

    # Aboard each has its own name.
    sources =
      for %{"type" => "decision"} = record <- CommandCase.audit(Path.join(dir, "aboard")),
          do: record["source"]

    assert sources |> Enum.uniq() |> Enum.sort() == ["hub", "tower"]

    HubServer.change(server, %{revoked: ["tower"]})
    HubServer.signal(server, "HUP")
    eventually(fn -> refused(Bridge.info(tower)) end, "the removed hub is refused")
    assert command(tower, "LOITER", "late").status in [:failed, :denied]
    completed(first, "RTL")
    assert SimVehicle.state(sim).mode == "RTL"

    # The hub's key was lost: another one, which the vehicle does not list until it has its new file.
    HubServer.change(server, %{new_keys: ["hub"]})
    HubServer.signal(server, "HUP")
    eventually(fn -> refused(Bridge.info(first)) end, "the lost key is refused")
    again = start_hub(set, "hub", Path.join(dir, "again"))
    eventually(fn -> is_map(Fleet.vehicle(again, @vehicle)) end, "it is shown")

    eventually(
      fn ->
        match?(
          %{status: :denied, details: %{"rule" => "signature"}},
          command(again, "LOITER", Aerie.Vehicle.Command.id())
        )
      end,
      "a key that it does not list commands nothing"
    )

    # The vehicle is taken out.
    HubServer.change(server, %{revoked: [@vehicle]})
    HubServer.signal(server, "HUP")
    eventually(fn -> Bridge.info(aboard)[:hub][:status] == :down end, "it has no hub any more")

    eventually(
      fn ->
        match?(
          %{status: :failed, details: %{"rule" => "unreachable"}},
          command(again, "LOITER", Aerie.Vehicle.Command.id())
        )
      end,
      "no hub reaches it"
    )

    assert SimVehicle.state(sim).mode == "RTL"
  end

  for host <- ["localhost", "::1"] do
    test "the hub's server is #{host}: its certificate is for that, aboard and at the hub", %{tmp_dir: dir} do
      server = HubServer.start(dir, [@vehicle], hosts: [unquote(host)])
      hub = start_hub(server.set, "hub", Path.join(dir, "hub"))
      %{gateway: aboard, sim: sim} = start_vehicle(server.set, Path.join(dir, "aboard"))
      eventually(fn -> Bridge.info(aboard)[:hub][:status] == :up end, fn -> inspect(Bridge.info(aboard)) end)
      eventually(fn -> is_map(Fleet.vehicle(hub, @vehicle)) end, "it is shown")
      completed(hub, "GUIDED")
      assert SimVehicle.state(sim).mode == "GUIDED"
    end
  end
end
