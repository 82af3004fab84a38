defmodule Aerie.Console.Pages.Plan.Page do
  @moduledoc """
  The page that draws missions, fences and rally points on the map, sends them to a vehicle, reads them from it, and opens and saves files.

  The draft lives in this page's process; the browser keeps a copy, so that neither a reload nor a restart of the gateway loses it.
  Viewers may edit the draft, but not change a vehicle.
  """
  use Aerie.Console,
      {:page,
       events: [
         viewer:
           ~w(plan_add plan_move plan_insert plan_pick part what altitude undo redo remove shift set clear_part close_zone drop_corners agree action vehicle home
              import export restore download verify close_transfer map_select map_follow map_escape)
       ],
       costly: ~w(import export restore download verify look)}

  import Aerie.Console.Map, only: [map: 1]
  import Aerie.Console.Pages.Plan.{Outcome, Panel}

  alias Aerie.Control.{Missions, Policy}
  alias Aerie.Fleet
  alias Protocols.Mission.Plan
  alias Aerie.Console.Map.{Payload, Zones}
  alias Aerie.Console.Pages.Plan.{Check, Draft, Edit, MapPayload, Profile, Transfer}
  alias Aerie.Access.WorkLimit

  @map "plan-map"
  # A larger copy would not fit into the browser's frame.
  @max_kept 200_000

  @impl Phoenix.LiveView
  def mount(_params, _session, socket) do
    {:ok,
     socket
     |> assign(page_title: "Plan", draft: %Draft{}, problems: [], vehicle: nil, vehicles: [], transfer: nil)
     |> assign(
       what: %{mission: 16, fence: {:inclusion, :polygon}},
       altitude: 30.0,
       error: nil,
       parts: [],
       agreed: nil
     )
     |> put_private(:plan, %{sent: %{}, judged: {[], []}, read: nil})
     |> subscribe()
     |> read()
     |> zones()}
  end

  @impl Phoenix.LiveView
  def handle_params(params, _uri, socket) do
    vehicle = Enum.find(socket.assigns.vehicles, &(&1.id == params["vehicle"]))
    {:noreply, socket |> assign(:vehicle, vehicle && vehicle.id) |> check() |> draw()}
  end

  @impl Phoenix.LiveView
  def handle_info(:refresh, socket), do: {:noreply, socket |> read() |> stand()}

  def handle_info({:transfer, ref, message}, %{assigns: %{transfer: %{ref: ref} = transfer}} = socket) do
    transfer = Transfer.update(transfer, message)
    socket = assign(socket, :transfer, transfer)

    if message == :done and transfer.what == :download and transfer.plan != nil,
      do:
        {:noreply,
         socket
         |> was_read({transfer.vehicle, transfer.plan})
         |> replace(transfer.plan)
         |> push_event("map:fit", %{map: @map, ids: []})},
      else: {:noreply, socket}
  end

  def handle_info(
        {:command_progress, {:transfer, ref}, _id, progress},
        %{assigns: %{transfer: %{ref: ref}}} = socket
      ),
      do: {:noreply, update(socket, :transfer, &Transfer.update(&1, {:progress, progress}))}

  def handle_info({kind, _ref_or_term, _message}, socket) when kind == :transfer, do: {:noreply, socket}
  def handle_info({:command_progress, _term, _id, _progress}, socket), do: {:noreply, socket}

  @impl Phoenix.LiveView
  def handle_event("plan_add", value, %{assigns: %{draft: draft, what: what, altitude: altitude}} = socket),
    do: {:noreply, result(socket, Draft.add(draft, Edit.place(value), what[draft.part], altitude))}

  def handle_event("plan_" <> how, value, %{assigns: %{draft: draft}} = socket)
      when how in ["move", "insert", "pick"] do
    with {:ok, {part, index, corner} = target} <- Edit.target(value) do
      case how do
        "move" ->
          {:noreply, result(socket, Draft.move(draft, target, Edit.place(value)))}

        "insert" ->
          {:noreply, result(socket, Draft.insert(draft, target, Edit.place(value)))}

        "pick" when part == draft.part ->
          {:noreply, socket |> assign(:draft, Draft.pick(draft, {index, corner})) |> draw()}

        "pick" ->
          {:noreply, socket}
      end
    else
      :error -> {:noreply, socket}
    end
  end

  def handle_event("part", %{"part" => name}, socket) do
    case Edit.part(name) do
      {:ok, part} ->
        {:noreply, socket |> update(:draft, &Draft.part(&1, part)) |> assign(:error, nil) |> draw()}

      :error ->
        {:noreply, socket}
    end
  end

  def handle_event("what", value, socket),
    do: {:noreply, socket |> update(:what, &Edit.what(&1, value)) |> keep()}

  def handle_event(
        "close_zone",
        _value,
        %{assigns: %{draft: draft, what: %{fence: {kind, _shape}}}} = socket
      ),
      do: {:noreply, result(socket, Draft.close(draft, kind))}

  def handle_event("drop_corners", value, socket) do
    which = if value["which"] == "last", do: :last, else: :all
    {:noreply, changed(socket, Draft.drop(socket.assigns.draft, which))}
  end

  # For the plan that was shown and the vehicle, and no other.
  def handle_event("agree", value, socket),
    do: {:noreply, assign(socket, :agreed, if(value["agreed"] == "true", do: value["shown"]))}

  def handle_event("altitude", value, socket) do
    case Edit.number(value["altitude"]) do
      {:ok, altitude} when altitude >= -500 and altitude <= 10_000 ->
        {:noreply, assign(socket, :altitude, altitude)}

      _no_altitude ->
        {:noreply, socket}
    end
  end

  def handle_event("undo", _value, socket), do: {:noreply, changed(socket, Draft.undo(socket.assigns.draft))}
  def handle_event("redo", _value, socket), do: {:noreply, changed(socket, Draft.redo(socket.assigns.draft))}

  def handle_event("clear_part", _value, socket),
    do: {:noreply, result(socket, Draft.clear(socket.assigns.draft))}

  def handle_event("remove", value, %{assigns: %{draft: draft}} = socket) do
    case Edit.target(value) do
      {:ok, target} -> {:noreply, result(socket, Draft.remove(draft, target))}
      :error -> {:noreply, socket}
    end
  end

  def handle_event("shift", %{"index" => index, "by" => by}, socket) do
    with {:ok, index} <- Edit.index(index), true <- by in ["-1", "1"] do
      {:noreply, result(socket, Draft.shift(socket.assigns.draft, index, String.to_integer(by)))}
    else
      _wrong -> {:noreply, socket}
    end
  end

  def handle_event("set", value, socket),
    do: {:noreply, result(socket, Edit.set(socket.assigns.draft, value))}

  def handle_event("action", %{"command" => command}, socket) do
    case Aerie.Console.Pages.Plan.Kinds.parse(command) do
      {:ok, command} -> {:noreply, result(socket, Draft.add_action(socket.assigns.draft, command))}
      :error -> {:noreply, socket}
    end
  end

  def handle_event("vehicle", %{"vehicle" => id}, socket),
    do:
      {:noreply,
       push_patch(socket, to: if(id == "", do: "/plan", else: "/plan?" <> URI.encode_query(vehicle: id)))}

  # The vehicle's home.
  def handle_event("home", _value, socket) do
    case socket.assigns.vehicle && Fleet.vehicle(socket.assigns.gateway, socket.assigns.vehicle) do
      %{groups: %{home: %{data: %{lat: lat, lon: lon} = home}}} when is_number(lat) and is_number(lon) ->
        {:noreply,
         result(socket, Draft.set_home(socket.assigns.draft, {lat, lon}, Edit.or_zero(home[:alt_msl])))}

      _unknown ->
        {:noreply, assign(socket, :error, "the vehicle has not reported its home")}
    end
  end

  def handle_event("import", %{"name" => name, "text" => text}, socket)
      when is_binary(name) and is_binary(text) do
    case imported(socket, text, :any) do
      {:ok, plan} ->
        {:noreply, socket |> was_read(nil) |> replace(plan) |> push_event("map:fit", %{map: @map, ids: []})}

      {:error, reason} ->
        {:noreply, assign(socket, :error, "#{String.slice(name, 0, 80)}: #{reason}")}
    end
  end

  def handle_event("import", %{"error" => text}, socket) when is_binary(text),
    do: {:noreply, assign(socket, :error, String.slice(text, 0, 200))}

  def handle_event("export", %{"format" => format}, socket) do
    format = Map.get(%{"waypoints" => :waypoints, "mission" => :mission}, format, :plan)

    case Missions.export(socket.assigns.draft.plan, format) do
      {:ok, text} -> {:noreply, push_event(socket, "plan:file", %{name: "aerie.#{format}", text: text})}
      {:error, reason} -> {:noreply, assign(socket, :error, "Not saved for iNav: #{reason}")}
    end
  end

  # The copy of an earlier page; it never replaces a newer drawing.
  def handle_event("restore", %{"text" => text} = kept, %{assigns: %{draft: %{undo: []} = draft}} = socket)
      when is_binary(text) do
    case imported(socket, text, :plan) do
      {:ok, plan} ->
        draft = draft |> Draft.replace(plan) |> Draft.resume(kept["corners"])
        {:noreply, socket |> update(:what, &Edit.what(&1, kept)) |> changed(draft)}

      {:error, _reason} ->
        {:noreply, socket}
    end
  end

  def handle_event("restore", _value, socket), do: {:noreply, socket}

  def handle_event(what, value, %{assigns: %{vehicle: vehicle, transfer: transfer}} = socket)
      when what in ["upload", "download", "verify", "look", "remove_aboard"] do
    press =
      if match?(%{"id" => id} when is_binary(id), value), do: value["id"], else: Aerie.Vehicle.Command.id()

    cond do
      vehicle == nil ->
        {:noreply, assign(socket, :error, "choose a vehicle first")}

      transfer != nil and not Transfer.over?(transfer) ->
        {:noreply, socket}

      what == "upload" and value["shown"] != Transfer.target(vehicle, socket.assigns.draft.plan) ->
        {:noreply, assign(socket, :error, "the plan or the vehicle changed; nothing was sent")}

      what == "upload" and socket.assigns.draft.corners != [] ->
        {:noreply, assign(socket, :error, "a zone is not closed yet; nothing was sent")}

      what == "upload" and Check.outside?(socket.assigns.problems) and socket.assigns.agreed != value["shown"] ->
        {:noreply,
         assign(socket, :error, "the plan leaves a fence, and nobody has agreed to that; nothing was sent")}

      not (press =~ ~r/\A[A-Za-z0-9_-]{1,64}\z/) ->
        {:noreply, socket}

      true ->
        {:noreply, begin(socket, job(what, value, socket.assigns), press)}
    end
  end

  def handle_event("close_transfer", _value, socket) do
    over? = socket.assigns.transfer == nil or Transfer.over?(socket.assigns.transfer)
    {:noreply, if(over?, do: assign(socket, :transfer, nil), else: socket)}
  end

  def handle_event("map_" <> _event, _value, socket), do: {:noreply, socket}

  defp job("look", _value, %{draft: draft}), do: {:look, draft.part}

  # The button names what is removed, whatever the page shows since.
  defp job("remove_aboard", value, %{vehicle: vehicle, transfer: transfer}) do
    case transfer do
      %{vehicle: ^vehicle, aboard: %{digest: digest} = aboard} when digest != nil ->
        if value["digest"] == digest and value["vehicle"] == vehicle, do: {:remove, aboard}

      _nothing_seen ->
        nil
    end
  end

  defp job(what, _value, _assigns), do: Edit.transfer(what)

  defp begin(socket, nil, _press), do: assign(socket, :error, "what is to be removed has changed: look again")

  defp begin(
         %{assigns: %{gateway: gateway, vehicle: vehicle, draft: draft, user: user}} = socket,
         what,
         press
       ) do
    options = [as: user, via: "console", read: was_read(socket)]
    transfer = Transfer.start(what, gateway, vehicle, draft.plan, press, options)
    # The plan aboard is about to change.
    socket = if what == :upload or match?({:remove, _}, what), do: was_read(socket, nil), else: socket
    assign(socket, transfer: transfer, error: nil)
  end

  # The plan as it was read from the chosen vehicle.
  defp was_read(%{assigns: %{vehicle: vehicle}, private: %{plan: %{read: read}}}),
    do: with({^vehicle, plan} <- read, do: plan, else: (_other -> nil))

  defp was_read(socket, read), do: put_private(socket, :plan, %{socket.private.plan | read: read})

  defp result(socket, {:ok, draft}), do: changed(socket, draft)
  defp result(socket, {:error, text}), do: socket |> assign(:error, text) |> draw()

  defp replace(%{assigns: %{draft: draft}} = socket, plan), do: changed(socket, Draft.replace(draft, plan))

  defp changed(socket, draft),
    do: socket |> assign(draft: draft, error: nil) |> check() |> draw() |> keep()

  # A copy that could not be read again must not replace an earlier one that could.
  defp keep(%{assigns: %{draft: %{plan: plan, corners: corners}, what: what}} = socket) do
    {:ok, text} = Missions.export(plan, :plan)

    if connected?(socket) and byte_size(text) <= @max_kept and match?({:ok, _}, Missions.import(text, :plan)),
      do: push_event(socket, "plan:keep", %{text: text, zone: MapPayload.open(corners, what.fence)}),
      else: socket
  end

  defp check(%{assigns: %{gateway: gateway, draft: %{plan: plan}, vehicle: vehicle, user: user}} = socket) do
    snapshot = vehicle && Fleet.vehicle(gateway, vehicle)
    parts = Transfer.parts(plan, was_read(socket))
    sent = for {kind, :send} <- parts, do: kind
    denied = if snapshot && plan != %Plan{}, do: Check.policy(gateway, plan, sent, snapshot, user), else: []
    own = Check.own(plan, snapshot, :fence in sent, was_read(socket))
    denied = Check.unfinished(socket.assigns.draft.corners) ++ denied

    socket
    |> put_private(:plan, %{socket.private.plan | judged: {denied, Check.alone(plan)}})
    |> assign(parts: parts, problems: denied ++ own ++ Check.alone(plan))
  end

  # The vehicle moves: whether it is inside the fence that is drawn is checked again.
  defp stand(%{assigns: %{vehicle: nil}} = socket), do: socket
  defp stand(%{assigns: %{draft: %{plan: %{fence: []}}}} = socket), do: socket

  defp stand(
         %{
           assigns: %{gateway: gateway, vehicle: vehicle, draft: %{plan: plan}, parts: parts, problems: known}
         } = socket
       ) do
    {denied, alone} = socket.private.plan.judged

    problems =
      denied ++
        Check.own(plan, Fleet.vehicle(gateway, vehicle), {:fence, :send} in parts, was_read(socket)) ++ alone

    if problems == known, do: socket, else: socket |> assign(:problems, problems) |> draw()
  end

  defp draw(%{assigns: %{draft: draft, problems: problems}} = socket),
    do: push_event(socket, "map:plan", %{map: @map, plan: MapPayload.payload(draft, problems)})

  defp zones(%{assigns: %{gateway: gateway}} = socket),
    do: push_event(socket, "map:zones", %{map: @map, zones: Zones.of(Policy.in_force(gateway))})

  defp imported(%{assigns: %{gateway: gateway, user: user}}, text, format) do
    case WorkLimit.run(gateway, :parse, {:name, user.name}, fn -> Missions.import(text, format) end) do
      {:ok, result} -> result
      {:busy, seconds} -> {:error, "too many files at once: try again in #{seconds} s"}
    end
  end

  defp read(%{assigns: %{gateway: gateway}} = socket) do
    vehicles = Fleet.vehicles(gateway)
    {payload, sent} = Payload.changes(socket.private.plan.sent, Enum.flat_map(vehicles, &List.wrap(row(&1))))
    socket = put_private(socket, :plan, %{socket.private.plan | sent: sent})

    # A firmware without missions has no other plans either.
    listed =
      for vehicle <- vehicles,
          do: %{id: vehicle.id, status: vehicle.status, gap: Missions.gap(vehicle, :mission)}

    socket = assign(socket, :vehicles, listed)

    if payload && connected?(socket),
      do: push_event(socket, "map:vehicles", Map.put(payload, :map, @map)),
      else: socket
  end

  defp row(vehicle), do: with([_ | _] = row <- Payload.row(vehicle), do: [row])

  @impl Phoenix.LiveView
  def render(assigns) do
    assigns = assign(assigns, :profile, Profile.points(assigns.draft.plan))

    ~H"""
    <div class="plan" id="plan" phx-hook="PlanFile">
      <h1 class="visually-hidden">Plan</h1>
      <div class="plan-left">
        <.map id="plan-map" class="plan-map" label="Map on which the plan is drawn" tool="plan" tools={~w(in out north fit measure)} />
        <.profile points={@profile} problems={@problems} />
      </div>
      <section class="plan-panel" aria-label="The plan">
        <.head
          vehicle={@vehicle}
          vehicles={@vehicles}
          parts={@parts}
          draft={@draft}
          user={@user}
          transfer={@transfer}
          problems={@problems}
          agreed={@agreed}
        />
        <.outcome :if={@transfer} transfer={@transfer} vehicle={@vehicle} user={@user} />
        <p :if={@error} class="notice bad" role="alert"><.icon name="alert" /> <span>{@error}</span></p>
        <.tools
          draft={@draft}
          what={@what}
          altitude={@altitude}
          vehicle={@vehicle}
          vehicles={@vehicles}
          user={@user}
          transfer={@transfer}
        />
        <.problems problems={@problems} />
        <.items :if={@draft.part == :mission} draft={@draft} problems={@problems} />
        <.fences :if={@draft.part == :fence} draft={@draft} />
        <.rally :if={@draft.part == :rally} draft={@draft} />
      </section>
    </div>
    """
  end
end
