defmodule Aerie.Console.Commands.Courses do
  @moduledoc """
  Follows each vehicle's commands to their end (`Aerie.Console.Commands.Outcome`), whether or not a page is open: a
  page that is loaded later shows what was reached, and all pages show the same. Subscribers of `{:commands, vehicle}`
  hear of an end.
  """
  use GenServer

  alias Aerie.Base.{Names, PubSub}
  alias Aerie.Control.Commands
  alias Aerie.Fleet
  alias Aerie.Console.Commands.Outcome

  # As many as a page shows.
  @commands 20
  @look_ms 250

  @doc "Options: `:gateway`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do:
      GenServer.start_link(__MODULE__, options[:gateway],
        name: Names.via(options[:gateway], :console_courses)
      )

  @doc "The courses of a vehicle's latest commands by id, as of now. Exits if the server is gone."
  @spec of(Names.gateway(), vehicle :: String.t()) :: %{String.t() => Outcome.t()}
  def of(gateway, vehicle),
    do: GenServer.call(Names.via(gateway, :console_courses), {:of, vehicle}, :infinity)

  @impl GenServer
  def init(gateway) do
    Process.set_label({:console_courses, gateway})
    :ok = PubSub.subscribe(gateway, :roster)

    {:ok,
     Enum.reduce(Fleet.vehicles(gateway), %{gateway: gateway, courses: %{}, timer: nil}, &follow(&2, &1.id))}
  end

  @impl GenServer
  def handle_call({:of, vehicle}, _from, state) do
    state = follow(state, vehicle)
    {:reply, Map.get(state.courses, vehicle, %{}), state}
  end

  @impl GenServer
  def handle_info({:fleet, :roster, vehicle}, state), do: {:noreply, follow(state, vehicle)}
  def handle_info({:fleet, {:commands, vehicle}, _id}, state), do: {:noreply, follow(state, vehicle)}

  def handle_info(:look, state) do
    going = for {vehicle, courses} <- state.courses, going?(courses), do: vehicle
    {:noreply, Enum.reduce(going, %{state | timer: nil}, &follow(&2, &1))}
  end

  defp follow(%{gateway: gateway, courses: courses} = state, id) do
    case Fleet.vehicle(gateway, id) do
      nil ->
        if is_map_key(courses, id), do: PubSub.unsubscribe(gateway, {:commands, id})
        %{state | courses: Map.delete(courses, id)}

      vehicle ->
        if not is_map_key(courses, id), do: PubSub.subscribe(gateway, {:commands, id})
        known = Map.get(courses, id, %{})
        entries = Commands.recent(gateway, id, @commands)
        seen = {Fleet.events(gateway, id), System.os_time(:microsecond)}
        new = Outcome.keep(known, entries, vehicle, seen)
        for {command, %{stage: :going}} <- known, ended?(new[command]), do: tell(gateway, id, command)
        look(%{state | courses: Map.put(courses, id, new)}, new)
    end
  end

  defp ended?(course), do: course != nil and course.stage != :going
  defp tell(gateway, vehicle, command), do: PubSub.publish(gateway, {:commands, vehicle}, command)

  defp look(%{timer: nil} = state, courses) do
    if going?(courses), do: %{state | timer: Process.send_after(self(), :look, @look_ms)}, else: state
  end

  defp look(state, _courses), do: state

  defp going?(courses), do: Enum.any?(courses, fn {_id, course} -> course.stage == :going end)
end
