defmodule Aerie.ActCase do
  @moduledoc "Vehicles that several acts are for, and what becomes of them, for tests of the fleet's sheets."

  import ExUnit.Callbacks, only: [start_supervised!: 2]
  import Phoenix.LiveViewTest

  alias Aerie.Base.{Names, Store}
  alias Aerie.{ConsoleCase, Fleet}
  alias Aerie.Vehicle.Command.Result

  @doc "A gateway without vehicles that takes commands and operations."
  @spec start(String.t()) :: ConsoleCase.t()
  def start(dir) do
    [console: console] = ConsoleCase.start_console()
    Aerie.CommandCase.start_commands(dir, gateway: console.gateway)
    :ok = Store.delete_vehicle(console.gateway, {"main", 7})
    ConsoleCase.start_operations(console)
    console
  end

  @doc "Puts the vehicle `V` and `n` into the store. However slow the machine is, it was heard just now."
  @spec put(ConsoleCase.t(), pos_integer(), keyword(), map()) :: :ok
  def put(console, n, groups, fields \\ %{}) do
    known = %{
      key: {"main", n},
      system_id: n,
      component: 1,
      time_boot_ms: 60_000,
      memory: %{sources: %{}, mode_names: %{}}
    }

    ConsoleCase.put_vehicle(console, "V#{n}", groups, Map.merge(known, fields))

    later = System.os_time(:microsecond) + 3_600_000_000
    vehicle = Store.vehicle(console.gateway, "V#{n}")
    groups = Map.new(vehicle.groups, fn {name, group} -> {name, %{group | at: later}} end)
    :ok = Store.put_vehicle(console.gateway, vehicle.key, %{vehicle | last_heard: later, groups: groups})
  end

  @doc "Takes the commands of a vehicle, tells the test of each, and has them completed; `:slow`: each after a `:go`."
  @spec executor(ConsoleCase.t(), pos_integer(), :fast | :slow) :: pid()
  def executor(console, n, pace \\ :fast) do
    test = self()

    start_supervised!(
      {Task,
       fn ->
         Names.register(console.gateway, :commands, {"main", n})
         serve(test, pace)
       end},
      id: {:executor, n}
    )
  end

  defp serve(test, pace) do
    receive do
      {:"$gen_call", from, {:submit, command, _progress, _still?}} ->
        send(test, {:commanded, command.vehicle, command.type, command.params})
        if pace == :slow, do: receive(do: (:go -> :ok))
        GenServer.reply(from, Result.new(command.id, :completed))
        serve(test, pace)
    end
  end

  @doc "What a held button carries."
  @spec value(struct(), selector :: String.t()) :: map()
  def value(view, button) do
    [_all, value] = Regex.run(~r/data-value="([^"]+)"/, view |> element(button) |> render())
    value |> String.replace("&quot;", "\"") |> String.replace("&#39;", "'") |> JSON.decode!()
  end

  @doc "Holds the button of the sheet that is open."
  @spec hold(struct(), map(), id :: String.t()) :: String.t()
  def hold(view, value, id \\ "web-1"), do: render_hook(view, "sheet_go", Map.put(value, "id", id))

  @doc "The operations that were begun."
  @spec operations(ConsoleCase.t()) :: [map()]
  def operations(console), do: Fleet.recent_operations(console.gateway)

  @doc "Kills the processes of all pages."
  @spec kill_pages(ConsoleCase.t()) :: :ok
  def kill_pages(console) do
    pages = Aerie.Console.Supervisor.pages(console.gateway)
    for {_id, pid, _type, _modules} <- DynamicSupervisor.which_children(pages), do: Process.exit(pid, :kill)
    :ok
  end
end
