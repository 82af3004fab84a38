defmodule Aerie.Console.Pages.Plan.Panel do
  @moduledoc "The parts of the plan page beside the map."
  use Aerie.Console, :component

  alias Protocols.Mission.{Item, Plan}
  alias Aerie.Control.Policy.Roles
  alias Aerie.Console.Pages.Plan.{Check, Edit, Kinds, Profile, Transfer}

  @width 600
  @height 90

  attr :vehicle, :string, required: true
  attr :vehicles, :list, required: true
  attr :parts, :list, required: true
  attr :draft, :map, required: true
  attr :user, :map, required: true
  attr :transfer, :map, required: true
  attr :problems, :list, required: true

  attr :agreed, :string,
    default: nil,
    doc: "the plan and vehicle for which somebody agreed that a fence is left"

  @doc "The choice of vehicle, and the buttons to send, read, open and save a plan."
  def head(assigns) do
    sent =
      for {kind, :send} <- assigns.parts,
          do: "#{Transfer.label(kind)} (#{Plan.contents(assigns.draft.plan, kind)})"

    shown = Transfer.target(assigns.vehicle, assigns.draft.plan)
    outside? = Check.outside?(assigns.problems)

    why =
      why(
        assigns.vehicle,
        busy?(assigns.transfer),
        sent == [],
        Enum.any?(assigns.problems, &(&1.kind == :bad))
      ) || if(outside? and assigns.agreed != shown, do: "Tick that the plan may leave the fence")

    gap = gap(assigns.vehicles, assigns.vehicle)
    idle? = assigns.vehicle == nil or busy?(assigns.transfer) or gap != nil

    assigns =
      assign(assigns, idle?: idle?, sent: sent, gap: gap, why: gap || why, shown: shown, outside?: outside?)

    ~H"""
    <div class="plan-head">
      <form id="plan-vehicle" phx-change="vehicle" phx-submit="vehicle">
        <.field
          id="plan-vehicle-field"
          type="select"
          name="vehicle"
          label="Vehicle"
          label_hidden
          value={@vehicle}
          options={[{"No vehicle", ""} | Enum.map(@vehicles, &{&1.id, &1.id})]}
        />
      </form>
      <div class="plan-with">
        <.button icon="download" phx-click="download" disabled={@idle?} title={@gap}>Read</.button>
        <.button icon="check" phx-click="verify" disabled={@idle?} title={@gap}>Compare</.button>
        <.hold_button
          :if={Roles.at_least?(@user.role, :operator)}
          id="plan-upload"
          event="upload"
          value={%{shown: @shown}}
          icon="upload"
          disabled={@why != nil}
          reason={@why}
        >Send</.hold_button>
      </div>
      <span class="plan-files">
        <label class="button" for="plan-import"><.icon name="upload" />Open file…<input
            id="plan-import"
            class="visually-hidden"
            type="file"
            accept=".plan,.waypoints,.mission,.txt,.json,.xml"
          /></label>
        <.button icon="download" phx-click="export" phx-value-format="plan">Save as .plan</.button>
        <.button icon="download" phx-click="export" phx-value-format="waypoints">Save as .waypoints</.button>
        <.button icon="download" phx-click="export" phx-value-format="mission">Save as .mission</.button>
      </span>
      <p :if={@why && @gap == nil && Roles.at_least?(@user.role, :operator)} id="plan-why" class="hint">{@why}.</p>
      <p :if={@gap} id="plan-gap" class="notice info" role="note"><.icon name="info" /> <span>{@gap}.</span></p>
          <form
        :if={@vehicle && @outside? && Roles.at_least?(@user.role, :operator)}
        id="plan-agree"
        phx-change="agree"
        phx-submit="agree"
        phx-auto-recover="ignore"
      >
        <input type="hidden" name="shown" value={@shown} />
        <.field
          id="plan-agreed"
          type="checkbox"
          name="agreed"
          label="Send it although it leaves the fence (below)"
          value={@agreed == @shown}
        />
      </form>
      <p
        :if={@gap == nil && @vehicle && @sent != [] && Roles.at_least?(@user.role, :operator)} id="plan-sends"
        class="muted"
      >Sends: {Enum.join(@sent, ", ")}. What else is aboard stays as it is.</p>
        </div>
    """
  end

  defp gap(vehicles, id), do: Enum.find_value(vehicles, &(&1.id == id && &1.gap))

  defp busy?(transfer), do: transfer != nil and not Transfer.over?(transfer)

  defp why(nil, _busy?, _nothing?, _bad?), do: "Choose a vehicle"
  defp why(_vehicle, true, _nothing?, _bad?), do: "Another transfer is under way"
  defp why(_vehicle, _busy?, true, _bad?), do: "Nothing to send: the plan is empty, or as it was read"
  defp why(_vehicle, _busy?, _nothing?, true), do: "The plan has errors"
  defp why(_vehicle, _busy?, _nothing?, _bad?), do: nil

  attr :draft, :map, required: true
  attr :what, :map, required: true
  attr :altitude, :float, required: true
  attr :vehicle, :string, required: true
  attr :vehicles, :list, required: true
  attr :user, :map, required: true
  attr :transfer, :map, required: true

  @doc "The choice of part, what a click adds, undo and redo."
  def tools(assigns) do
    ~H"""
    <div class="plan-parts" role="group" aria-label="What is drawn">
      <.button
        :for={{part, n} <- parts(@draft.plan)}
        phx-click="part"
        phx-value-part={part}
        aria-pressed={if @draft.part == part, do: "true", else: "false"}
      >{Transfer.label(part)} ({n})</.button>
    </div>
    <div class="plan-tools">
      <form :if={@draft.part == :mission} id="plan-what" phx-change="what" phx-submit="what">
        <.field id="plan-command" type="select" name="command" label="Click to add" value={@what.mission} options={Kinds.options(true)} />
      </form>
      <form :if={@draft.part == :fence} id="plan-shape" phx-change="what" phx-submit="what">
        <.field id="plan-zone" type="select" name="shape" label="Click to add" value={Edit.shape(@what.fence)} options={Edit.shapes()} />
      </form>
      <div :if={@draft.part == :fence && @draft.corners != []} id="plan-corners" class="row" role="status">
        <span>Corner {length(@draft.corners)} of a zone</span>
        <.button
          small
          kind="primary"
          icon="check"
          phx-click="close_zone"
          disabled={length(@draft.corners) < 3}
          title="Or click its first corner"
        >Close the zone</.button>
        <.button small phx-click="drop_corners" phx-value-which="last">Remove last corner</.button>
        <.button small phx-click="drop_corners" phx-value-which="all">Drop</.button>
      </div>
      <form :if={@draft.part != :fence} id="plan-altitude" phx-change="altitude" phx-submit="altitude">
        <.field id="plan-altitude-field" type="number" step="any" name="altitude" label="Height (above home)" unit="m" value={number(@altitude)} phx-debounce="300" />
      </form>
      <form :if={@draft.part == :mission} id="plan-action" phx-submit="action">
        <.field id="plan-action-field" type="select" name="command" label="Add action" options={Kinds.options(false)} />
        <.button type="submit" icon="plus" label="Add" />
      </form>
      <div class="row">
        <.button small phx-click="undo" disabled={@draft.undo == [] and @draft.corners == []}>Undo</.button>
        <.button small phx-click="redo" disabled={@draft.redo == []}>Redo</.button>
        <.button :if={@draft.part == :mission} small icon="home" phx-click="home" disabled={@vehicle == nil}>Use vehicle's home</.button>
        <.button small icon="trash" phx-click="clear_part">Clear</.button>
        <.button
          :if={@vehicle && Roles.at_least?(@user.role, :operator) && gap(@vehicles, @vehicle) == nil}
          small
          phx-click="look"
          disabled={busy?(@transfer)}
          title="Reads what the vehicle has, to remove it"
        >Remove from vehicle…</.button>
      </div>
    </div>
    """
  end

  defp parts(plan) do
    [
      {:mission, length(plan.items)},
      {:fence, length(plan.fence)},
      {:rally, length(plan.rally)}
    ]
  end

  attr :problems, :list, required: true

  @doc "The findings about the plan."
  def problems(assigns) do
    ~H"""
    <ul :if={@problems != []} id="plan-problems" class="plan-problems" aria-label="Problems" aria-live="polite">
      <li :for={problem <- Enum.take(@problems, 20)} class={["notice", Atom.to_string(problem.kind)]}>
        <.icon name="alert" /><span>{problem.text}</span>
      </li>
    </ul>
    """
  end

  attr :draft, :map, required: true
  attr :problems, :list, required: true

  @doc "The items of the mission; the selected one with its fields."
  def items(assigns) do
    ~H"""
    <.empty :if={@draft.plan.items == []} icon="plan" title="No mission yet">
      Click on the map to add waypoints, open a file, or read what a vehicle has.
    </.empty>
    <ol :if={@draft.plan.items != []} id="plan-items" class="plan-items">
      <li :for={{item, n} <- Enum.with_index(@draft.plan.items)} :key={n} class={picked?(@draft, n) && "picked"}>
        <div class="plan-item">
          <button type="button" class="plan-pick" phx-click="plan_pick" phx-value-part="mission" phx-value-index={n} aria-expanded={expanded(@draft, n)}>
            <span class="plan-number">{n + 1}</span> <strong>{Kinds.name(item.command)}</strong>
            <span class="muted">{height(item)}</span>
            <.badge :if={Enum.any?(@problems, &(&1.index == n and &1.part == :mission))} kind="bad">!</.badge>
          </button>
          <.button small kind="quiet" icon="chevron-up" label={"Move item #{n + 1} up"} phx-click="shift" phx-value-index={n} phx-value-by="-1" />
          <.button small kind="quiet" icon="chevron-down" label={"Move item #{n + 1} down"} phx-click="shift" phx-value-index={n} phx-value-by="1" />
          <.button small kind="quiet" icon="trash" label={"Remove item #{n + 1}"} phx-click="remove" phx-value-part="mission" phx-value-index={n} />
        </div>
        <form :if={picked?(@draft, n)} id={"plan-item-#{n}"} class="plan-fields" phx-change="set" phx-submit="set" phx-auto-recover="ignore">
          <input type="hidden" name="part" value="mission" /><input type="hidden" name="index" value={n} />
          <.field id={"item-#{n}-command"} type="select" name="command" label="Kind" value={item.command} options={kinds(item)} />
          <.field :if={item.frame != 2} id={"item-#{n}-z"} type="number" step="any" name="z" label={height_label(item.frame)} unit="m" value={number(item.z)} phx-debounce="500" />
          <.field :if={item.frame != 2} id={"item-#{n}-frame"} type="select" name="frame" label="Reference" value={plain(item.frame)} options={frames(item)} />
          <.field :if={placed?(item)} id={"item-#{n}-lat"} type="number" step="any" name="lat" label="Latitude" unit="°" value={degrees(item.x)} phx-debounce="500" />
          <.field :if={placed?(item)} id={"item-#{n}-lon"} type="number" step="any" name="lon" label="Longitude" unit="°" value={degrees(item.y)} phx-debounce="500" />
          <.field
            :for={{p, label, unit, _default} <- Kinds.params(item.command)}
            :key={p}
            id={"item-#{n}-p#{p}"}
            type="number"
            step="any"
            name={"p#{p}"}
            label={label}
            unit={unit}
            value={number(elem(item.params, p - 1))}
            phx-debounce="500"
          />
        </form>
      </li>
    </ol>
    """
  end

  attr :draft, :map, required: true

  @doc "The zones of the fence."
  def fences(assigns) do
    ~H"""
    <.others remarks={Plan.remarks(@draft.plan, :fence)} />
    <.empty :if={@draft.plan.fence == []} icon="shield" title="No fence yet">Click on the map to begin a zone, then drag its corners.</.empty>
    <ol :if={@draft.plan.fence != []} id="plan-zones" class="plan-items">
      <li :for={{{kind, shape}, n} <- Enum.with_index(@draft.plan.fence)} :key={n} class={picked?(@draft, n) && "picked"}>
        <div class="plan-item">
          <button type="button" class="plan-pick" phx-click="plan_pick" phx-value-part="fence" phx-value-index={n}>
            <span class="plan-number">{n + 1}</span> <strong>{zone(kind)}</strong> <span class="muted">{shape(shape)}</span>
          </button>
          <.button
            :if={corner?(@draft, n)}
            small
            phx-click="remove"
            phx-value-part="fence"
            phx-value-index={n}
            phx-value-corner={elem(@draft.picked, 1)}
          >Remove corner {elem(@draft.picked, 1) + 1}</.button>
          <.button small kind="quiet" icon="trash" label={"Remove zone #{n + 1}"} phx-click="remove" phx-value-part="fence" phx-value-index={n} />
        </div>
        <form :if={picked?(@draft, n)} id={"plan-zone-#{n}"} class="plan-fields" phx-change="set" phx-submit="set" phx-auto-recover="ignore">
          <input type="hidden" name="part" value="fence" /><input type="hidden" name="index" value={n} />
          <.field
            id={"zone-#{n}-kind"}
            type="select"
            name="kind"
            label="Vehicles"
            value={Atom.to_string(kind)}
            options={[{"stay inside", "inclusion"}, {"keep out", "exclusion"}]}
          />
          <.field :if={match?({:circle, _, _}, shape)} id={"zone-#{n}-radius"} type="number" step="any" name="radius" label="Radius" unit="m" value={radius(shape)} phx-debounce="500" />
        </form>
      </li>
    </ol>
    """
  end

  attr :remarks, :list, required: true

  defp others(assigns) do
    ~H"""
    <p :for={remark <- @remarks} class="notice warn"><.icon name="alert" /> <span>{remark}</span></p>
    """
  end

  attr :draft, :map, required: true

  @doc "The rally points."
  def rally(assigns) do
    ~H"""
    <.others remarks={Plan.remarks(@draft.plan, :rally)} />
    <.empty :if={@draft.plan.rally == []} icon="home" title="No rally points yet">Click on the map where vehicles may return to in place of home.</.empty>
    <ol :if={@draft.plan.rally != []} id="plan-rally" class="plan-items">
      <li :for={{{{lat, lon}, altitude}, n} <- Enum.with_index(@draft.plan.rally)} :key={n} class={picked?(@draft, n) && "picked"}>
        <div class="plan-item">
          <button type="button" class="plan-pick" phx-click="plan_pick" phx-value-part="rally" phx-value-index={n}>
            <span class="plan-number">R{n + 1}</span> <span class="muted">{altitude(altitude)}</span>
          </button>
          <.button small kind="quiet" icon="trash" label={"Remove rally point #{n + 1}"} phx-click="remove" phx-value-part="rally" phx-value-index={n} />
        </div>
        <form :if={picked?(@draft, n)} id={"plan-rally-#{n}"} class="plan-fields" phx-change="set" phx-submit="set" phx-auto-recover="ignore">
          <input type="hidden" name="part" value="rally" /><input type="hidden" name="index" value={n} />
          <.field id={"rally-#{n}-z"} type="number" step="any" name="z" label={height_label(frame(altitude))} unit="m" value={number(metres(altitude))} phx-debounce="500" />
          <.field id={"rally-#{n}-lat"} type="number" step="any" name="lat" label="Latitude" unit="°" value={degrees(lat)} phx-debounce="500" />
          <.field id={"rally-#{n}-lon"} type="number" step="any" name="lon" label="Longitude" unit="°" value={degrees(lon)} phx-debounce="500" />
        </form>
      </li>
    </ol>
    """
  end

  attr :points, :list, required: true
  attr :problems, :list, required: true

  @doc "The height profile."
  def profile(assigns) do
    wrong = for %{part: :mission, index: index} when index != nil <- assigns.problems, do: index
    drawing = Profile.drawing(assigns.points, @width, @height)

    assigns =
      assign(assigns,
        drawing: drawing,
        wrong: wrong,
        box: "-6 -8 #{@width + 12} #{@height + 16}",
        height: @height
      )

    ~H"""
    <figure :if={@drawing} id="plan-profile" class="plan-profile">
      <svg viewBox={@box} preserveAspectRatio="none" role="img" aria-label={summary(@drawing)}>
        <line class="plan-ground" x1="0" x2="600" y1={ground(@drawing, @height)} y2={ground(@drawing, @height)} />
        <polyline class="plan-line" points={@drawing.line} />
        <circle :for={dot <- @drawing.dots} class={if dot.index in @wrong, do: "plan-dot bad", else: "plan-dot"} cx={"#{dot.x}"} cy={"#{dot.y}"} r="4">
          <title>{"Item #{dot.index + 1}"}</title>
        </circle>
      </svg>
      <figcaption class="muted">{summary(@drawing)}</figcaption>
    </figure>
    """
  end

  defp summary(drawing),
    do:
      "#{kilometres(drawing.length)} · #{round(drawing.low)} to #{round(drawing.high)} m above home · terrain unknown"

  defp kilometres(metres) when metres < 1000, do: "#{round(metres)} m"
  defp kilometres(metres), do: "#{:erlang.float_to_binary(metres / 1000, decimals: 1)} km"

  defp ground(%{low: low, high: high}, height), do: "#{Float.round(high / (high - low) * height, 1)}"

  defp picked?(%{picked: {index, _corner}}, index), do: true
  defp picked?(_draft, _index), do: false

  defp expanded(draft, n), do: if(picked?(draft, n), do: "true", else: "false")

  defp corner?(%{picked: {n, corner}, plan: plan}, n) when is_integer(corner),
    do: match?({_kind, {:polygon, [_, _, _, _ | _]}}, Enum.at(plan.fence, n))

  defp corner?(_draft, _n), do: false

  defp placed?(%{x: x, y: y} = item),
    do: Item.place?(item.command, item.frame) and is_integer(x) and is_integer(y)

  # The frames with 1e-7 degrees mean the same as those with floats.
  defp plain(frame), do: Integer.to_string(Protocols.Mission.Item.plain_frame(frame))

  defp frames(item) do
    if Enum.any?(Edit.frames(), fn {_label, frame} -> frame == plain(item.frame) end),
      do: Edit.frames(),
      else: [{"frame #{item.frame}", plain(item.frame)} | Edit.frames()]
  end

  defp kinds(item) do
    all = Kinds.options(true) ++ Kinds.options(false)

    if Enum.any?(all, fn {_name, command} -> command == item.command end),
      do: all,
      else: [{Kinds.name(item.command), item.command} | all]
  end

  defp height(%{frame: 2}), do: nil
  defp height(%{z: nil}), do: nil
  defp height(%{z: z}), do: "#{number(z)} m"

  defp zone(:inclusion), do: "Stay inside"
  defp zone(:exclusion), do: "Keep out"

  defp shape({:polygon, corners}), do: "#{length(corners)} corners"
  defp shape({:circle, _centre, radius}), do: "circle of #{number(radius)} m"

  defp radius({:circle, _centre, metres}), do: number(metres)

  defp altitude(height), do: "#{number(metres(height))} m #{Plan.above(height)}"
  defp frame({_metres, frame}), do: frame
  defp frame(_above_home), do: 3

  defp height_label(frame) do
    labels = %{"0" => "Altitude (MSL)", "3" => "Height (above home)", "10" => "Height (above ground)"}
    Map.get(labels, plain(frame), "Height")
  end

  defp metres({metres, _frame}), do: metres
  defp metres(metres), do: metres

  defp number(nil), do: nil
  defp number(value) when value == trunc(value), do: value |> trunc() |> Integer.to_string()
  defp number(value), do: value |> Float.round(3) |> Aerie.Base.Json.encode!()

  defp degrees(e7), do: :erlang.float_to_binary(e7 / 1.0e7, decimals: 6)
end
