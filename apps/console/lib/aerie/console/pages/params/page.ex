defmodule Aerie.Console.Pages.Params.Page do
  @moduledoc """
  The parameters of a vehicle's autopilot: read, searched, compared with their defaults and with a file, set one by one or from a file, saved,
  with what the vehicle says about them; those of its cameras and other components: read, searched, set one by one.

  Reading needs no permission. A change is checked like a command (`Aerie.Control.Params`), has the id of its button press, and its progress and result
  appear among the vehicle's commands, as on the vehicle's page.
  """
  use Aerie.Console,
      {:page,
       events: [viewer: ~w(vehicle filter read describe stop_reading open_file close_file save close_param)],
       costly: ~w(filter read open_file close_file save)}

  import Aerie.Console.Pages.Params.Parts

  alias Aerie.Control.{Commands, Params}
  alias Aerie.Fleet
  alias Aerie.Control.Policy.Roles
  alias Aerie.Base.PubSub
  alias Aerie.Console.Commands.{Entry, EntryList}
  alias Aerie.Console.Pages.Params.{Components, Listing, Reading}
  alias Aerie.Access.WorkLimit

  @all %{search: "", only: "all"}
  # The command type of a change.
  @set "set_parameter"

  @impl Phoenix.LiveView
  def mount(_params, _session, socket) do
    {:ok,
     socket
     |> assign(
       page_title: "Parameters",
       vehicle: nil,
       component: nil,
       components: [],
       about: %{},
       table: nil,
       reading: nil,
       problem: nil,
       file: nil,
       lives: [],
       undo: nil,
       open: nil,
       given: nil,
       error: nil
     )
     |> assign(
       filter: @all,
       able: Enum.any?([:maintain, :pilot], &Roles.allowed?(socket.assigns.user, &1)),
       now: System.os_time(:microsecond)
     )
     |> relist()
     |> subscribe([:vehicles])
     |> vehicles()}
  end

  @impl Phoenix.LiveView
  def handle_params(params, _uri, socket) do
    id = if Fleet.vehicle(socket.assigns.gateway, params["vehicle"] || ""), do: params["vehicle"]
    component = component(params["component"])
    search = params["search"]

    socket =
      if {id, component} == {socket.assigns.vehicle, socket.assigns.component},
        do: socket,
        else: choose(socket, id, component)

    socket = if is_binary(search), do: searched(socket, search), else: socket
    {:noreply, assign(socket, open: params["p"], given: given(params["value"]), error: nil)}
  end

  defp searched(socket, text),
    do: socket |> assign(:filter, %{@all | search: String.slice(text, 0, 100)}) |> relist()

  defp given(text) when is_binary(text), do: String.slice(text, 0, 128)
  defp given(_none), do: nil

  # Any may be asked for: not each of them sends heartbeats.
  defp component(text) do
    case Integer.parse(text || "") do
      {component, ""} when component in 1..255 -> component
      _none -> nil
    end
  end

  defp choose(%{assigns: %{gateway: gateway, vehicle: before}} = socket, id, component) do
    if connected?(socket) do
      if before, do: PubSub.unsubscribe(gateway, {:commands, before})
      if id, do: PubSub.subscribe(gateway, {:commands, id})
    end

    # A search goes on with the next vehicle; a camera has other names.
    filter = if component == socket.assigns.component, do: socket.assigns.filter, else: @all

    socket =
      socket
      |> stop()
      |> assign(filter: filter)
      |> assign(vehicle: id, component: component, table: nil, about: %{}, problem: nil, file: nil)
      |> relist()
      |> commands()
      |> vehicles()

    if id && connected?(socket), do: read(socket), else: socket
  end

  defp read(socket), do: read(socket, {:list, socket.assigns.component})

  defp read(%{assigns: %{gateway: gateway, vehicle: id}} = socket, what),
    do: socket |> stop() |> assign(reading: Reading.start(gateway, id, what), problem: nil)

  defp stop(%{assigns: %{reading: nil}} = socket), do: socket

  defp stop(%{assigns: %{reading: reading, gateway: gateway}} = socket) do
    _ended_already = Reading.cancel(reading, gateway)
    assign(socket, :reading, nil)
  end

  @impl Phoenix.LiveView
  def handle_info(:refresh, %{assigns: %{lives: []}} = socket), do: {:noreply, vehicles(socket)}
  def handle_info(:refresh, socket), do: {:noreply, socket |> vehicles() |> follow()}

  def handle_info(
        {:command_progress, {:params, ref}, _id, progress},
        %{assigns: %{reading: %{ref: ref} = reading}} = socket
      ),
      do: {:noreply, assign(socket, :reading, %{reading | progress: progress})}

  def handle_info({:params, ref, {:ok, read}}, %{assigns: %{reading: %{ref: ref, what: what}}} = socket) do
    read = if what == :descriptions, do: [about: read], else: [table: read]
    {:noreply, socket |> assign([reading: nil] ++ read) |> relist()}
  end

  def handle_info({:params, ref, {:error, text}}, %{assigns: %{reading: %{ref: ref}}} = socket),
    do: {:noreply, assign(socket, problem: text, reading: nil)}

  def handle_info({:fleet, {:commands, id}, _command}, %{assigns: %{vehicle: id}} = socket),
    do: {:noreply, follow(socket)}

  def handle_info(_late, socket), do: {:noreply, socket}

  @impl Phoenix.LiveView
  def handle_event("vehicle", %{"vehicle" => id} = fields, socket) do
    component = if id == socket.assigns.vehicle, do: component(fields["component"])
    {:noreply, push_patch(socket, to: path(id, component))}
  end

  def handle_event("read", _value, %{assigns: %{vehicle: id}} = socket) when is_binary(id),
    do: {:noreply, read(socket)}

  def handle_event("describe", _value, %{assigns: %{table: %{}, component: nil}} = socket),
    do: {:noreply, read(socket, :descriptions)}

  def handle_event("stop_reading", _value, socket), do: {:noreply, stop(socket)}

  def handle_event("filter", fields, socket) do
    only = if fields["only"] in Listing.choices(), do: fields["only"], else: "all"
    filter = %{search: String.slice(fields["search"] || "", 0, 60), only: only}
    {:noreply, socket |> assign(:filter, filter) |> relist()}
  end

  def handle_event(
        "open_file",
        %{"name" => name, "text" => text},
        %{assigns: %{table: %{}, component: nil, vehicle: id, gateway: gateway}} = socket
      )
      when is_binary(name) and is_binary(text) do
    case WorkLimit.run(gateway, :parse, {:name, socket.assigns.user.name}, fn ->
           Params.read_file(text, Fleet.vehicle(gateway, id))
         end) do
      {:ok, {:ok, entries, remarks}} ->
        file = %{name: String.slice(name, 0, 100), entries: entries, remarks: remarks}

        {:noreply,
         socket |> assign(file: file, filter: %{socket.assigns.filter | only: "differs"}) |> relist()}

      {:ok, {:error, errors}} ->
        {:noreply, put_flash(socket, :error, Enum.join(errors, "; "))}

      {:busy, seconds} ->
        {:noreply, put_flash(socket, :error, "Too many files at once: try again in #{seconds} s.")}
    end
  end

  def handle_event("open_file", %{"error" => text}, socket) when is_binary(text),
    do: {:noreply, put_flash(socket, :error, text)}

  def handle_event("close_file", _value, socket),
    do: {:noreply, socket |> assign(file: nil, filter: %{socket.assigns.filter | only: "all"}) |> relist()}

  def handle_event(
        "save",
        %{"format" => format},
        %{assigns: %{table: %{} = table, component: nil, vehicle: id, gateway: gateway}} = socket
      )
      when format in ~w(param params) do
    kind = if format == "param", do: :param, else: :params
    text = Params.text(table, kind, Fleet.vehicle(gateway, id))
    {:noreply, push_event(socket, "params:file", %{name: "#{id}.#{format}", text: text})}
  end

  def handle_event("close_param", _value, socket), do: {:noreply, push_patch(socket, to: path(socket))}

  # The page's table is what the operator saw; the vehicle itself reports whether it accepted a value.
  def handle_event(
        "command",
        %{"type" => "set", "id" => press, "fields" => %{"name" => name, "value" => text}} = event,
        %{assigns: %{table: %{}}} = socket
      )
      when is_binary(text) do
    with %{} = param <- socket.assigns.table.params[name],
         was = Listing.text(param.value),
         :ok <- meant(event, socket, was),
         {:ok, value} <- Listing.value(text, param.type) do
      %{gateway: gateway, vehicle: id, component: component} = socket.assigns
      options = [type: param.type, component: component, was: was] ++ options(socket, press)
      gateway |> Params.set(id, name, value, options) |> answered(socket)
    else
      :changed -> changed(socket)
      nil -> {:noreply, put_flash(socket, :error, "The vehicle has no parameter of this name.")}
      :error -> {:noreply, assign(socket, :error, "expected a number")}
    end
  end

  def handle_event(
        "command",
        %{"type" => "load", "id" => press} = event,
        %{assigns: %{table: %{} = table, file: %{} = file}} = socket
      ) do
    {differing, _missing} = Params.differing(file.entries, table)
    %{gateway: gateway, vehicle: id} = socket.assigns

    if meant(event, socket, differing) == :ok,
      do: gateway |> Params.set_all(id, differing, options(socket, press)) |> answered(socket),
      else: changed(socket)
  end

  def handle_event("cancel", %{"id" => command}, %{assigns: %{vehicle: id}} = socket) when is_binary(id) do
    case Commands.cancel(socket.assigns.gateway, id, command, socket.assigns.user, "console") do
      :ok -> {:noreply, socket}
      {:error, _why, text} -> {:noreply, put_flash(socket, :error, "Not cancelled: #{text}")}
    end
  end

  def handle_event(_other, _value, socket), do: {:noreply, socket}

  # A press is for the vehicle and the values that its operator saw: another one may be chosen by now, or other values read.
  defp meant(event, %{assigns: %{vehicle: id, component: component}}, seen),
    do: if(event["shown"] == Listing.target(id, component, seen), do: :ok, else: :changed)

  defp changed(socket),
    do: {:noreply, put_flash(socket, :error, "The vehicle or its values changed; nothing was sent.")}

  defp options(socket, press), do: [id: press, as: socket.assigns.user, via: "console", wait_ms: 0]

  defp answered({:pending, _id}, socket), do: {:noreply, push_patch(socket, to: path(socket))}

  defp answered({:ok, %{status: status, reason: reason}}, socket) when status in [:denied, :rejected],
    do: {:noreply, put_flash(socket, :error, "Not set: #{reason}")}

  defp answered({:ok, _result}, socket), do: {:noreply, push_patch(socket, to: path(socket))}

  defp answered({:error, errors}, socket),
    do: {:noreply, put_flash(socket, :error, "Not set: #{Enum.join(errors, "; ")}")}

  defp vehicles(%{assigns: %{gateway: gateway, vehicle: id, component: component}} = socket) do
    vehicle = id && Fleet.vehicle(gateway, id)
    others = if vehicle, do: Components.others(gateway, vehicle, component), else: []

    assign(socket,
      vehicles: for(vehicle <- Fleet.vehicles(gateway), do: vehicle.id),
      components: others,
      snapshot: vehicle,
      via: vehicle && vehicle.via
    )
  end

  defp commands(%{assigns: %{vehicle: nil}} = socket), do: assign(socket, lives: [], undo: nil)

  defp commands(%{assigns: %{gateway: gateway, vehicle: id}} = socket) do
    entries = for %{type: @set} = entry <- Commands.recent(gateway, id, 20), do: entry
    lives = for entry <- Enum.take(entries, 5), do: Entry.of(entry)
    assign(socket, lives: lives, undo: undo(entries), now: System.os_time(:microsecond))
  end

  # What the parameter that was set last had before.
  defp undo([%{result: %{status: :completed}, params: %{was: was} = set} | _earlier]),
    do: %{name: set.name, was: was, component: set[:component]}

  defp undo(_entries), do: nil

  # When somebody has set a parameter, the list is read again. The gateway has it, or reads what changed.
  defp follow(%{assigns: %{lives: before}} = socket) do
    socket = commands(socket)
    known = for life <- before, not Entry.under_way?(life), do: life.id

    if Enum.any?(socket.assigns.lives, &(&1.id not in known and not Entry.under_way?(&1))),
      do: read(socket),
      else: socket
  end

  # The visible part of the table, computed only when it changed.
  defp relist(%{assigns: %{table: nil}} = socket),
    do: assign(socket, rows: [], total: 0, differing: [], missing: [])

  defp relist(%{assigns: %{table: table, file: file, about: about, filter: filter}} = socket) do
    {rows, total} = Listing.rows(table, entries(file), about, filter)
    {differing, missing} = Params.differing(entries(file), table)
    assign(socket, rows: rows, total: total, differing: differing, missing: missing)
  end

  @impl Phoenix.LiveView
  def render(assigns) do
    param = assigns.table && assigns.open && assigns.table.params[assigns.open]
    entry = param && Enum.find(entries(assigns.file), &(&1.name == param.name))
    assigns = assign(assigns, :row, param && Listing.row(param, entry, assigns.about[param.name]))

    ~H"""
    <h1 class="page-title">Parameters</h1>
    <div class="stack">
      <.toolbar vehicles={@vehicles} vehicle={@vehicle} components={@components} component={@component} described={@about != %{}} filter={@filter} reading={@reading} table={@table} file={@file} via={@via} />
      <.elsewhere :if={@via} via={@via}>It reads them. Descriptions and setting parameters from a file are available only there.</.elsewhere>
      <.progress :if={@reading} reading={@reading} />
      <EntryList.lives id="params-commands" lives={@lives} now={@now} user={@user} />
      <p :if={@undo && @able} class="hint" id="params-undo">
        {@undo.name} was {@undo.was}. <.link patch={path(@vehicle, @undo.component, @undo.name, @undo.was)}>Set it back…</.link>
      </p>
      <.error :if={@problem} title="The parameters could not be read">{@problem}</.error>
      <.empty :if={@vehicle == nil} icon="params" title="No vehicle chosen">{if @vehicles == [], do: "No vehicles yet", else: "Choose one above."}</.empty>
      <.file
        :if={@file && @table}
        file={@file}
        vehicle={@vehicle}
        differing={@differing}
        cautions={Listing.cautions(Enum.map(@differing, & &1.name), @snapshot)}
        missing={@missing}
        able={@able}
        via={@via}
      />
      <.table :if={@table} rows={@rows} total={@total} path={&path(@vehicle, @component, &1)} file={@file} />
      <.editor
        :if={@row}
        row={@row}
        vehicle={@vehicle}
        component={@component}
        able={@able}
        cautions={Listing.cautions([@row.name], @snapshot)}
        given={@given}
        error={@error}
      />
    </div>
    """
  end

  defp entries(nil), do: []
  defp entries(file), do: file.entries

  defp path(%Phoenix.LiveView.Socket{assigns: %{vehicle: id, component: component}}), do: path(id, component)

  defp path(id, component, name \\ nil, value \\ nil)
  defp path(none, _component, _name, _value) when none in [nil, ""], do: "/params"

  defp path(id, component, name, value) do
    asked = [vehicle: id, component: component, p: name, value: value]
    query = for {key, value} <- asked, value != nil, do: {key, value}
    "/params?" <> URI.encode_query(query)
  end
end
