defmodule Aerie.Upgrade.ObstaclesTest do
  use Aerie.SystemCase, async: true

  alias Aerie.CLI.Subcommand
  alias Aerie.Control.Commands.Recent
  alias Aerie.Control.Policy.{Intent, Roles}
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Control.Policy.Memory.RecentCommands
  alias Aerie.Upgrade
  alias Aerie.Vehicle.Command
  alias MavRouter.Sharing.TransferLock

  @moduletag :tmp_dir

  setup %{tmp_dir: folder} do
    %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0"])
    port = link_port(gateway, "link-1")
    start_supervised!({SimVehicle.Fleet, count: 1, link: "udpout:127.0.0.1:#{port}", fly: false})
    eventually(fn -> Store.vehicle(gateway, "VID-001") end, "the vehicle is known")
    %{gateway: gateway, key: Store.vehicle(gateway, "VID-001").key}
  end

  defp obstacle(context, text) do
    eventually(fn -> Enum.any?(Upgrade.obstacles(context.gateway), &(&1 =~ text)) end, text)
  end

  defp none(context) do
    eventually(fn -> Upgrade.obstacles(context.gateway) == [] end, fn ->
      inspect(Upgrade.obstacles(context.gateway))
    end)
  end

  test "each thing that would be lost is named while it is under way",
       %{gateway: gateway, key: key} = context do
    # The gateway reads what it wants to know of a vehicle that it hears for the first time.
    none(context)
    pilot = Roles.principal(:user, "ann", :operator)

    {:ok, _lease} =
      Holders.change(gateway, key, {:take, nil, nil}, pilot, "rest", %{
        required: false,
        take_over: :admin
      })

    obstacle(context, "VID-001: ann is in charge of it")

    {:ok, _none} =
      Holders.change(gateway, key, :release, pilot, "rest", %{required: false, take_over: :admin})

    RecentCommands.note(gateway, "VID-001", "olga", %Intent{type: "rc_override", permission: :fly})
    obstacle(context, "VID-001: olga steers it by its sticks")
    RecentCommands.note(gateway, "VID-001", "olga", %Intent{type: "rtl", permission: :fly})
    RecentCommands.setpoint(gateway, "VID-001", 60_000)
    obstacle(context, "VID-001: set-points steer it")
    Store.forget(gateway, {:setpoints, "VID-001"})

    :go = TransferLock.take(gateway, key, :log)
    obstacle(context, "VID-001: a transfer (log) is under way")
    TransferLock.give_back(gateway, key, :log)

    command = %Command{
      id: "c1",
      vehicle: "VID-001",
      type: "takeoff",
      params: %{},
      source: "ann",
      issued_at: 0,
      deadline: 0
    }

    Recent.begun(gateway, command, "rest")
    obstacle(context, "VID-001: takeoff of ann is under way")
    Recent.done(gateway, Command.Result.new("c1", :completed, nil))

    none(context)
  end

  test "a checkout is not installed" do
    assert {:error, text} =
             Subcommand.Running.Upgrade.run(%{name: "upgrade", arguments: %{}, options: %{}, folder: "/"})

    assert text =~ "is not installed"
  end
end
