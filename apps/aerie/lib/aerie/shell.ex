defmodule Aerie.Shell do
  @moduledoc """
  Short helpers for the shell in a running gateway (`bin/aerie remote`), where they are imported.

      fleet()                           all vehicles
      v "sim-001"                       one vehicle: its state, with ages
      links()                           all links
      watch "sim-001", :ATTITUDE        a message of a vehicle, as it comes
      trace "radio-1"                   which messages go over a link, in and out, for some seconds
      cmd "sim-001", :rtl               a command; what moves a vehicle asks first
      cmd "sim-001", :goto, lat: 47.39, lon: 8.54, altitude: 30
      shadow "sim-001"                  what is desired and reported of a vehicle
      top()                             the busiest processes
      sup()                             the supervision tree, with its restarts
      drop "radio-1"                    ends a link; asks first
      sim 2                             adds simulated vehicles (in a checkout)
      health()                          whether the gateway is ready, and what is wrong

  What is read comes from the read model: no vehicle's process waits for it. All of them work on the gateway that `bin/run` or a release
  has started, `:default`; for anything else the shell has the whole of `Aerie`.
  """

  alias Aerie.Base.{Printable, Store}
  alias Aerie.Fleet
  alias Aerie.Fleet.{Inspector, Shadow}
  alias MavRouter.Link
  alias Aerie.Vehicle.Snapshot
  alias Aerie.Processes
  alias Aerie.Shell.Text
  alias Aerie.CLI.{Ask, Subcommand}
  alias Aerie.CLI.Output.Columns
  alias Aerie.CLI.Status.{Table, View}

  @gateway :default
  @sim_link "sim-shell"

  @doc "The banner of a shell."
  @spec greet() :: :ok
  def greet do
    IO.puts("Aerie #{Application.spec(:aerie, :vsn)} on #{node()}")
    health()

    IO.puts(
      "\nfleet(), links(), v ID, watch ID, :MESSAGE, cmd ID, :TYPE, top(), sup(): h Aerie.Shell describes all of them. exit() or Ctrl-C twice leaves."
    )
  end

  @doc "Leaves the shell; the gateway goes on."
  @spec exit() :: :ok
  def exit do
    Aerie.CLI.Subcommand.Running.Remote.leave(node(Process.group_leader()))
    :ok
  end

  @doc "Whether the gateway is ready, and what is wrong."
  @spec health() :: :ok
  def health do
    {_status, text} =
      Subcommand.Running.Status.run(%{name: "status", arguments: %{}, options: %{}, folder: "."})

    IO.write(text)
  end

  @doc "All vehicles; `VIA` is the gateway by which one is reached that this gateway's links do not hear."
  @spec fleet() :: :ok
  def fleet, do: @gateway |> View.collect() |> Table.vehicles() |> IO.write()

  @doc "One vehicle: its state by groups, with ages."
  @spec v(String.t()) :: :ok
  def v(id) do
    with_vehicle(id, fn vehicle ->
      links = Store.links(@gateway)
      IO.write(Text.vehicle(vehicle, Snapshot.now(vehicle, links, System.os_time(:microsecond))))
    end)
  end

  @doc "All links."
  @spec links() :: :ok
  def links, do: @gateway |> View.collect() |> Table.links() |> IO.write()

  @doc "Prints a message of a vehicle whenever it comes, `count` times, for at most half a minute."
  @spec watch(String.t(), atom(), pos_integer()) :: :ok
  def watch(id, message, count \\ 10) do
    with_vehicle_here(id, fn vehicle ->
      inspecting(fn ->
        wanted = to_string(message)
        # Two networks may each have a vehicle with this id; the links tell which one it is.
        of = fn ->
          for(
            %{key: {link, :in, _s, _c, _id} = key, name: ^wanted} = row <-
              Inspector.rows(@gateway, system: vehicle.system_id),
            link in vehicle.links,
            do: {key, row}
          )
        end

        watch_rows(of, %{}, count, 150)
      end)
    end)
  end

  defp watch_rows(_of, _seen, left, rounds) when left <= 0 or rounds == 0, do: :ok

  defp watch_rows(of, seen, left, rounds) do
    rows = of.()
    fresh = for({key, row} <- rows, seen[key] != row.count, do: key) |> Enum.take(left)
    for key <- fresh, frame = Inspector.last(@gateway, key), do: IO.puts(Text.message(key, frame))
    Process.sleep(200)
    watch_rows(of, Map.new(rows, fn {key, row} -> {key, row.count} end), left - length(fresh), rounds - 1)
  end

  @doc "Which messages go over a link: after `seconds`, a line for each, with direction, rate and count."
  @spec trace(String.t(), pos_integer()) :: :ok
  def trace(link, seconds \\ 5) do
    if Store.link(@gateway, link) == nil do
      IO.puts(
        "there is no link #{Columns.cell(link)}; known are #{Enum.map_join(Store.links(@gateway), ", ", & &1.id)}"
      )
    else
      inspecting(fn ->
        Process.sleep(seconds * 1000)
        IO.write(Text.trace(Inspector.rows(@gateway, link: link)))
      end)
    end
  end

  @doc "Commands a vehicle, and prints the result. What moves a vehicle asks first."
  @spec cmd(String.t(), atom() | String.t(), keyword()) :: :ok
  def cmd(id, type, params \\ []) do
    case Subcommand.Command.give(
           id,
           to_string(type),
           Map.new(params, fn {name, value} -> {to_string(name), value} end),
           %{}
         ) do
      {:error, text} -> IO.puts("error: " <> Printable.lines(text))
      {_status, text} -> IO.write(Printable.lines(text))
    end
  end

  @doc "The desired and reported state of a vehicle, and the status of each field."
  @spec shadow(String.t()) :: map() | :ok
  def shadow(id) do
    case Shadow.get(@gateway, id) do
      {:ok, document} -> document
      {:error, refusal} -> IO.puts("error: " <> Shadow.text(refusal))
    end
  end

  @doc "The busiest processes, of one second."
  @spec top() :: :ok
  def top, do: 1_000 |> Processes.busiest() |> Text.top() |> IO.write()

  @doc "The supervision tree with its restarts."
  @spec sup() :: :ok
  def sup, do: @gateway |> Processes.tree() |> Text.tree() |> IO.write()

  @doc "Ends a link, and forgets it with its counters. Asks first."
  @spec drop(String.t()) :: :ok
  def drop(link) do
    with %{} <- Store.link(@gateway, link),
         :ok <- Ask.first("end the link #{link}", %{}) do
      Link.stop(@gateway, link)
    else
      nil -> IO.puts("there is no link #{Columns.cell(link)}")
      {:error, text} -> IO.puts(text)
    end
  end

  @doc "Adds `n` simulated vehicles on a network of their own; a release has none."
  @spec sim(pos_integer()) :: :ok
  def sim(n) when n in 1..50 do
    if Code.ensure_loaded?(SimVehicle.Fleet) do
      first = Enum.count(Store.vehicles(@gateway), &(&1.network == @sim_link)) + 1

      with {:ok, port} <- sim_port(),
           child = {SimVehicle.Fleet, count: n, first_system: first, link: "udpout:127.0.0.1:#{port}"},
           {:ok, _pid} <-
             Supervisor.start_child(
               Aerie.CLI.Supervisor,
               Supervisor.child_spec(child, id: {:sim_shell, first})
             ) do
        IO.puts("added #{n}, from #{@sim_link}-#{String.pad_leading("#{first}", 3, "0")} on")
      else
        {:error, reason} ->
          IO.puts("error: #{if is_exception(reason), do: Exception.message(reason), else: inspect(reason)}")
      end
    else
      IO.puts("a release has no simulated vehicles")
    end
  end

  defp sim_port do
    case Link.get(@gateway, @sim_link) do
      %{port: port} when is_integer(port) ->
        {:ok, port}

      _none ->
        with {:ok, @sim_link} <- Link.start(@gateway, "udpin:127.0.0.1:0", id: @sim_link, network: @sim_link),
             do: {:ok, Link.snapshot(@gateway, @sim_link).port}
    end
  end

  defp with_vehicle(id, fun) do
    case Fleet.vehicle(@gateway, id) do
      nil -> IO.puts(Subcommand.Running.Tail.unknown(id))
      vehicle -> fun.(vehicle)
    end
  end

  # Seen only on the links.
  defp with_vehicle_here(id, fun) do
    with_vehicle(id, fn
      %{via: via} when via != nil -> IO.puts(Subcommand.Running.Tail.elsewhere(id, via))
      vehicle -> fun.(vehicle)
    end)
  end

  defp inspecting(fun) do
    case Inspector.watch(@gateway) do
      :ok ->
        fun.()
        Inspector.unwatch(@gateway)

      {:error, :no_recorder} ->
        IO.puts("there is no recorder, by which messages are seen")

      {:error, :not_running} ->
        IO.puts("the gateway does not run")
    end
  end
end
