defmodule Aerie.Console.Pages.Vehicle.Page do
  @moduledoc """
  The page of one vehicle: flying, commanding, and its state. Its sections have their own addresses; hold, return and land are in reach in
  all of them.

  The page reads the store when it has changed, at most five times a second; attitude, position and chart samples go to the browser as
  events. Commands go through `Aerie.Control.Commands` (`Aerie.Console.Commands.Submit`), whose table of recent commands everybody sees.
  """
  use Aerie.Console,
      {:page,
       events: [
         viewer:
           ~w(noop input events_filter events_pause chart_add command_search map_select map_follow map_escape map_point route)
       ]}

  alias Aerie.Base.Store
  alias Aerie.Control.Commands
  alias Aerie.Fleet
  alias Aerie.Fleet.Inspector
  alias MavRouter.Link
  alias Aerie.Vehicle.{Command, Snapshot}
  alias Aerie.Control.Policy
  alias Aerie.Console.Commands.{Courses, Entry, EntryList, Submit}
  alias Aerie.Console.Pages.Fleet.Plans
  alias Aerie.Console.Map.Payload

  alias Aerie.Console.Pages.Vehicle.Header
  alias Aerie.Console.Pages.Vehicle.Control.{Actions, CommandCheck, ControlBanner}
  alias Aerie.Console.Pages.Vehicle.Fly.Instruments
  alias Aerie.Console.Pages.Vehicle.LinkTable.Links
  alias Aerie.Console.Pages.Vehicle.{Section, Sections}
  alias Aerie.Console.Pages.Vehicle.Charts.{MessageSeries, Series}
  alias Aerie.Console.Pages.Vehicle.Health.Obstacles
  alias Aerie.Console.Pages.Vehicle.Fly.Route
  alias Aerie.Console.Pages.Vehicle.Control.Target
  alias Aerie.Console.Pages.Vehicle.View
  alias Aerie.Console.Pages.Vehicle.Events.Timeline

  # How long an ended command stays in sight in all sections.
  @shown_us 20_000_000
  @max_events 256
  # As long as the charts reach.
  @history_us 600_000_000
  @no_errors %{fields: %{}, general: []}

  @impl Phoenix.LiveView
  def mount(%{"id" => id}, _session, socket) do
    gateway = socket.assigns.gateway

    socket =
      socket
      |> assign(
        id: id,
        page_title: id,
        section: "fly",
        inputs: %{"altitude" => "10", "mode" => ""},
        form: %{},
        errors: @no_errors
      )
      |> assign(
        search: "",
        level: "all",
        events_search: "",
        paused: nil,
        series: [],
        command: nil,
        target: nil,
        answer: nil,
        obstacles: []
      )
      |> assign(
        aiming: false,
        following: true,
        map: %{},
        homes: nil,
        marked: nil,
        route: %Plans{},
        route_shown: nil,
        route_asked: false,
        view: nil,
        entries: [],
        courses: %{},
        listening: false,
        heard: [],
        message: "",
        events: Fleet.events(gateway, id)
      )
      |> subscribe([{:vehicle, id}, {:commands, id}, :links, :events, :leases])

    {:ok, commands(socket)}
  end

  @impl Phoenix.LiveView
  def handle_params(params, _uri, socket) do
    section = if Sections.section?(params["section"]), do: params["section"], else: "fly"

    series =
      params |> Map.get("f", "") |> String.split(",", trim: true) |> Series.choose(&MessageSeries.choose/1)

    command = if Command.type(params["c"]), do: params["c"]
    # When another command is chosen, its form starts with the defaults.
    form = if command == socket.assigns.command, do: socket.assigns.form, else: %{}
    errors = if command == socket.assigns.command, do: socket.assigns.errors, else: @no_errors
    socket = assign(socket, section: section, series: series, command: command, form: form, errors: errors)
    _ = if connected?(socket) and params["act"], do: send(self(), {:guided, place(params)})
    # The map is new when its section is shown again.
    {:noreply,
     socket |> assign(map: %{}, homes: nil, marked: nil, route_shown: nil) |> listen() |> load() |> history()}
  end

  # A place that was chosen on the fleet's map.
  defp place(%{"act" => act, "lat" => lat, "lon" => lon}) do
    with true <- is_binary(lat) and is_binary(lon),
         {lat, ""} <- Float.parse(lat),
         {lon, ""} <- Float.parse(lon) do
      %{"act" => act, "lat" => lat, "lon" => lon}
    else
      _other -> %{}
    end
  end

  defp place(_incomplete), do: %{}

  # What was before the page was opened, or the field chosen.
  defp history(%{assigns: %{section: "charts", series: [_ | _] = series, gateway: gateway, id: id}} = socket) do
    now = System.os_time(:microsecond)

    with true <- connected?(socket),
         {:ok, %{vehicles: %{^id => samples}}} <- Fleet.tracks(gateway, [id], now - @history_us, now, 1),
         [_ | _] = rows <- Series.history(samples, series) do
      rows = for {time, values} <- rows, do: [time, values]
      push_event(socket, "chart_history", %{chart: "charts", rows: rows})
    else
      _none -> socket
    end
  end

  defp history(socket), do: socket

  # Messages are watched only while they are charted, because watching costs the links time.
  defp listen(%{assigns: %{section: section, gateway: gateway, listening: listening}} = socket) do
    case {connected?(socket) and section == "charts", listening} do
      {same, same} -> socket
      {true, false} -> assign(socket, :listening, Inspector.watch(gateway) == :ok)
      {false, true} -> assign(socket, :listening, Inspector.unwatch(gateway) != :ok)
    end
  end

  @impl Phoenix.LiveView
  def handle_info(:refresh, socket), do: {:noreply, load(socket)}
  def handle_info({:fleet, {:commands, _vehicle}, _command}, socket), do: {:noreply, commands(socket)}

  def handle_info({:fleet, :events, %{vehicle: id} = event}, %{assigns: %{id: id}} = socket),
    do: {:noreply, update(socket, :events, &Enum.take(&1 ++ [event], -@max_events))}

  def handle_info({:fleet, :leases, _change}, socket), do: {:noreply, load(socket)}

  # Its address must not prepare it again when the page is loaded again.
  def handle_info({:guided, event}, %{assigns: %{id: id}} = socket) do
    {:noreply, socket} = handle_event("map_guided", event, socket)
    {:noreply, socket |> assign(:following, false) |> push_patch(to: Sections.path(id, "fly"), replace: true)}
  end

  def handle_info({:plan, id, ref, message}, socket),
    do: {:noreply, socket |> update(:route, &Plans.update(&1, id, ref, message)) |> route()}

  def handle_info(_other, socket), do: {:noreply, socket}

  @impl Phoenix.LiveView
  def handle_event("command", event, socket) do
    %{gateway: gateway, id: id, user: user} = socket.assigns

    case charge_meant?(socket, event) && Submit.give(gateway, id, user, event) do
      false -> {:noreply, put_flash(socket, :error, "Who is in charge changed; nothing was sent.")}
      {:invalid, type, errors} -> {:noreply, invalid(socket, type, errors)}
      {:done, status, text} when status in [:denied, :rejected] -> {:noreply, not_sent(socket, text)}
      _state -> {:noreply, socket |> clear_flash() |> assign(errors: @no_errors) |> sent(event["type"])}
    end
  end

  def handle_event("cancel", %{"id" => command}, socket) do
    %{gateway: gateway, id: id, user: user} = socket.assigns

    case Commands.cancel(gateway, id, command, user, "console") do
      :ok -> {:noreply, socket}
      {:error, _why, text} -> {:noreply, put_flash(socket, :error, "Not cancelled: #{text}")}
    end
  end

  def handle_event("input", fields, socket),
    do: {:noreply, update(socket, :inputs, &Map.merge(&1, texts(fields, ~w(altitude mode))))}

  def handle_event("command_change", fields, socket) do
    form = Map.reject(fields, fn {name, text} -> String.starts_with?(name, "_") or not is_binary(text) end)
    {:noreply, socket |> assign(form: form, errors: @no_errors) |> load()}
  end

  def handle_event("command_search", %{"search" => text}, socket),
    do: {:noreply, assign(socket, :search, String.slice(text, 0, 100))}

  def handle_event("events_filter", fields, socket) do
    level = if fields["level"] in Timeline.levels(), do: fields["level"], else: "all"
    {:noreply, assign(socket, level: level, events_search: String.slice(fields["search"] || "", 0, 100))}
  end

  def handle_event("events_pause", _value, socket),
    do: {:noreply, update(socket, :paused, &if(&1, do: nil, else: socket.assigns.events))}

  def handle_event("chart_add", %{"message" => name}, %{assigns: %{message: shown}} = socket)
      when is_binary(name) and name != shown,
      do: {:noreply, assign(socket, :message, String.slice(name, 0, 60))}

  def handle_event("chart_add", %{"key" => key}, socket) do
    keys = Enum.map(socket.assigns.series, & &1.key) ++ [key]

    {:noreply,
     push_patch(socket,
       to:
         Sections.charts_path(
           socket.assigns.id,
           keys |> Series.choose(&MessageSeries.choose/1) |> Enum.map(& &1.key)
         )
     )}
  end

  def handle_event("aim", _value, socket), do: {:noreply, update(socket, :aiming, &not/1)}
  def handle_event("aim_end", _value, socket), do: {:noreply, aim(socket, nil)}

  def handle_event("aim_change", fields, %{assigns: %{target: %{} = target}} = socket),
    do: {:noreply, aim(socket, Target.change(target, fields))}

  # A viewer's map cannot set a target, so such an event is ignored.
  def handle_event(name, place, %{assigns: %{view: %View{} = view, user: %{role: role}}} = socket)
      when name in ["map_point", "map_guided"] and role != :viewer do
    act = if name == "map_point", do: "goto", else: place["act"]
    {:noreply, socket |> assign(:aiming, false) |> aim(Target.new(view, act, place))}
  end

  def handle_event("map_escape", _value, socket), do: {:noreply, socket |> assign(:aiming, false) |> aim(nil)}

  def handle_event("route", _value, %{assigns: %{view: %View{} = view, route: plans}} = socket) do
    %{gateway: gateway, id: id} = socket.assigns
    plans = Plans.toggle(plans, gateway, [id], %{id => View.get(view, [:mission, :total])})
    {:noreply, socket |> assign(route: plans, route_asked: true) |> route()}
  end

  def handle_event("map_follow", value, socket),
    do: {:noreply, assign(socket, :following, value["id"] != nil)}

  def handle_event(_other, _value, socket), do: {:noreply, socket}

  # The page may show an earlier lease than there is.
  defp charge_meant?(%{assigns: %{gateway: gateway, view: %View{vehicle: vehicle}}}, event),
    do: ControlBanner.meant?(event, Policy.control_lease(gateway, vehicle.key))

  defp charge_meant?(_no_vehicle, _event), do: true

  defp texts(fields, names),
    do:
      for(
        {name, text} <- fields,
        name in names,
        is_binary(text),
        into: %{},
        do: {name, String.slice(text, 0, 60)}
      )

  defp sent(%{assigns: %{target: %{type: type}}} = socket, type),
    do: socket |> assign(aiming: false) |> aim(nil)

  defp sent(socket, "set_mode"), do: update(socket, :inputs, &%{&1 | "mode" => ""})
  defp sent(socket, _type), do: socket

  defp invalid(%{assigns: %{command: type, section: "commands"}} = socket, type, errors),
    do: assign(socket, :errors, errors)

  defp invalid(socket, _type, errors), do: not_sent(socket, Submit.text(errors))
  defp not_sent(socket, text), do: put_flash(socket, :error, "Not sent: #{text}")

  defp aim(socket, target) do
    socket |> assign(:target, target) |> mark() |> preview()
  end

  # A prepared target comes first, then the one that the vehicle flies to.
  defp mark(%{assigns: %{target: target, marked: marked, view: view} = assigns} = socket) do
    place =
      if target && view,
        do: Target.drawn(target, view),
        else: Target.on_its_way(assigns.entries, assigns.courses)

    if place == marked,
      do: socket,
      else: socket |> assign(:marked, place) |> push_event("map:target", %{map: "vehicle-map", place: place})
  end

  defp preview(%{assigns: assigns} = socket) do
    type = Obstacles.prepared(assigns)

    obstacles =
      with %View{} = view <- type && assigns.view,
           do: Obstacles.of(type, view, Snapshot.arming(view.vehicle, assigns.events, view.now)),
           else: (_none -> [])

    assign(socket, answer: CommandCheck.of(assigns), obstacles: obstacles)
  end

  defp commands(%{assigns: %{gateway: gateway, id: id}} = socket),
    do:
      socket
      |> assign(entries: Commands.recent(gateway, id, 20), now: System.os_time(:microsecond))
      |> lives()

  # How far commands are that have only begun, as the vehicle's state shows it now.
  defp lives(%{assigns: %{gateway: gateway, id: id, entries: entries}} = socket) do
    courses = Courses.of(gateway, id)

    socket
    |> assign(courses: courses, lives: Enum.map(entries, &Entry.of(&1, courses[&1.id])))
    |> mark()
  end

  defp load(%{assigns: %{gateway: gateway, id: id}} = socket) do
    now = System.os_time(:microsecond)
    socket = assign(socket, :now, now)

    case Fleet.vehicle(gateway, id) do
      nil ->
        assign(socket, :view, nil)

      vehicle ->
        socket
        |> assign(
          view: View.new(vehicle, Store.links(gateway), now),
          lease: Policy.control_lease(gateway, vehicle.key)
        )
        |> lives()
        |> part()
        |> preview()
    end
  end

  # Assigns that only one section shows.
  defp part(%{assigns: %{section: "fly", view: view}} = socket) do
    row = Payload.row(view.vehicle)
    {changes, map} = Payload.changes(socket.assigns.map, List.wrap(row && [row]))

    socket
    |> assign(:map, map)
    |> push_event("instruments", Instruments.sample(view.vehicle, view.now))
    |> onto_map(changes)
    |> homes(Payload.homes([Payload.home(view.vehicle)]))
    |> follow_mission()
  end

  defp part(%{assigns: %{section: "charts", series: series, view: view, gateway: gateway}} = socket) do
    {messages, states} = Enum.split_with(series, &is_tuple(&1.path))
    values = MessageSeries.sample(gateway, view.vehicle, messages, view.now)
    values = Map.merge(values, Series.sample(view.vehicle, states, view.now))
    socket = assign(socket, :heard, MessageSeries.names(gateway, view.vehicle))

    if series == [],
      do: socket,
      else: push_event(socket, "chart", %{chart: "charts", time: view.now / 1_000_000, values: values})
  end

  defp part(%{assigns: %{section: "links", view: view, gateway: gateway}} = socket),
    do: assign(socket, :link_rows, Links.of(view.vehicle, Link.list(gateway)))

  defp part(socket), do: socket

  defp follow_mission(%{assigns: %{gateway: gateway, view: view, route: plans, route_asked: asked}} = socket) do
    if connected?(socket) do
      route = Route.keep(plans, gateway, view, asked)
      socket |> assign(route: route, route_asked: asked or route != plans) |> route()
    else
      socket
    end
  end

  defp route(%{assigns: %{route: route, route_shown: shown, id: id, view: view}} = socket) do
    case Plans.payload(route, %{id => view && View.get(view, [:mission, :seq])}) do
      ^shown ->
        socket

      [] when shown == nil ->
        socket

      plans ->
        socket |> assign(:route_shown, plans) |> push_event("map:plans", %{map: "vehicle-map", plans: plans})
    end
  end

  defp onto_map(socket, nil), do: socket

  defp onto_map(socket, changes) do
    socket = push_event(socket, "map:vehicles", Map.put(changes, :map, "vehicle-map"))
    # The map starts at the vehicle's position.
    if changes.all,
      do: push_event(socket, "map:fit", %{map: "vehicle-map", ids: [socket.assigns.id], animate: false}),
      else: socket
  end

  defp homes(%{assigns: %{homes: homes}} = socket, homes), do: socket

  defp homes(socket, homes),
    do: socket |> assign(:homes, homes) |> push_event("map:homes", %{map: "vehicle-map", homes: homes})

  @impl Phoenix.LiveView
  def render(%{view: nil} = assigns) do
    ~H"""
    <h1 class="page-title">{@id}</h1>
    <.empty icon="vehicle" title="No such vehicle">
      The gateway has not heard of a vehicle with this name, or has forgotten it. <.link navigate="/">To the fleet</.link>
    </.empty>
    """
  end

  def render(assigns) do
    ~H"""
    <div class={["vehicle-page", "is-#{@view.vehicle.status}"]}>
      <Header.header view={@view} entries={@entries} courses={@courses} />
      <ControlBanner.charge view={@view} user={@user} lease={@lease} />
      <.tabs label="Parts of the page">
        <:tab :for={{name, label, icon} <- Sections.all()} patch={Sections.path(@id, name)} current={name == @section} icon={icon}>{label}</:tab>
      </.tabs>
      <Section.section {assigns} />
      <%!-- At the bottom, so that a command that appears or disappears does not move the buttons above. --%>
      <div class="vehicle-foot">
        <EntryList.lives id="commands-now" lives={in_sight(@lives, @now)} now={@now} user={@user} class="in-sight" />
        <Actions.bar view={@view} user={@user} />
      </div>
    </div>
    """
  end

  defp in_sight(lives, now),
    do: Enum.filter(lives, &(Entry.under_way?(&1) or &1.going or now - &1.done_at < @shown_us))
end
