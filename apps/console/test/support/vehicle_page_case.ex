defmodule Aerie.VehiclePageCase do
  @moduledoc """
  Tests of the page of one vehicle, VID-007, behind the real door: the store is filled by hand, and the test is the vehicle's executor.
  """
  use ExUnit.CaseTemplate

  import Aerie.CommandCase, only: [start_commands: 2]
  import Aerie.ConsoleCase
  import Phoenix.LiveViewTest, except: [conn: 1, conn: 2]

  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Base.Store
  alias Aerie.Vehicle.Event
  alias Aerie.ConsoleCase

  @id "VID-007"
  @path "/vehicles/VID-007"
  # Its values stay fresh, however long a test takes.
  @ahead_us 600_000_000

  using do
    quote do
      import Aerie.CommandCase, only: [answer: 3, executing: 1, refute_submitted: 0]
      import Aerie.{ConsoleCase, VehiclePageCase}
      import Phoenix.LiveViewTest, except: [conn: 1, conn: 2]

      @moduletag :tmp_dir
      @moduletag :capture_log
    end
  end

  setup %{tmp_dir: dir} = context do
    [console: console] = start_console()
    start_commands(dir, gateway: console.gateway, policy: context[:policy] || [max_altitude: 100])
    put(console)
    %{console: console}
  end

  @doc "How far the times of its values are ahead (µs)."
  @spec ahead_us() :: pos_integer()
  def ahead_us, do: @ahead_us

  @doc "Puts the vehicle into the store: as the executor's, in the air above its home."
  @spec put(ConsoleCase.t(), keyword(), map()) :: term()
  def put(console, groups \\ [], fields \\ %{}) do
    put_vehicle(
      console,
      @id,
      groups,
      Map.merge(
        %{
          key: {"main", 7},
          system_id: 7,
          component: 1,
          clock: %{rtt_us: 20_000},
          memory: %{sources: %{}, mode_names: %{}}
        },
        fields
      )
    )

    unless fields[:groups] do
      vehicle = Store.vehicle(console.gateway, @id)
      groups = Map.new(vehicle.groups, fn {name, group} -> {name, %{group | at: group.at + @ahead_us}} end)
      Store.put_vehicle(console.gateway, vehicle.key, %{vehicle | groups: groups})
    end
  end

  @doc "Opens the page."
  @spec open(ConsoleCase.t(), atom(), String.t()) :: term()
  def open(console, role \\ :operator, path \\ @path) do
    {:ok, view, _html} = live(conn(console, role), path)
    view
  end

  @doc "Gives a command, as the page's hooks do."
  @spec give(term(), String.t(), String.t(), map()) :: String.t()
  def give(view, type, id, more \\ %{}),
    do: render_hook(view, "command", Map.merge(%{"type" => type, "id" => id}, more))

  @doc "Commits an event of the vehicle."
  @spec happened(ConsoleCase.t(), String.t(), map(), pos_integer()) :: term()
  def happened(console, type, data, seq) do
    event = Event.new(@id, type, seq, System.os_time(:microsecond), nil, data)
    Journal.commit(console.gateway, @id, %{seq: seq}, [event])
  end
end
