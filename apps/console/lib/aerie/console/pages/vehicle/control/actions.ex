defmodule Aerie.Console.Pages.Vehicle.Control.Actions do
  @moduledoc """
  The commands that are always in reach (hold, return, land), and those of every flight: arm, take off, modes. Commands that the firmware lacks,
  or the user may not give, are left out.
  """
  use Aerie.Console, :component

  alias Aerie.Control.Commands
  alias Aerie.Vehicle.Firmware
  alias Aerie.Console.Commands.{Catalog, Guided, Panel}
  alias Aerie.Console.Pages.Vehicle.View
  alias Aerie.Console.Pages.Vehicle.Control.Target

  @flight [{"arm", "Arm"}, {"disarm", "Disarm"}, {"takeoff", "Take off"}, {"set_mode", "Set mode"}]
  @always [
    {"hold", "Hold", "hold", "H"},
    {"rtl", "Return", "rtl", "R"},
    {"land", "Land", "land", "L"}
  ]

  attr :view, View, required: true
  attr :user, :map, required: true

  @doc "The bar below every section, with the keys that are held down: H, R, L."
  def bar(assigns) do
    assigns =
      assign(assigns,
        actions: for({name, _, _, _} = action <- @always, able?(name, assigns), do: action),
        locked: locked(for({name, title, _, _} <- @always, do: {name, title}), assigns)
      )

    ~H"""
    <p :for={text <- @locked} class="muted locked"><.icon name="lock" /> {text}</p>
    <div :if={@actions != []} class="vehicle-bar" role="group" aria-label="Always in reach">
      <.hold_button :for={{name, label, icon, key} <- @actions} id={"action-#{name}"} event="command" icon={icon} kind="plain" shortcut={key} phx-value-type={name}>{label}</.hold_button>
    </div>
    """
  end

  attr :view, View, required: true
  attr :user, :map, required: true
  attr :inputs, :map, required: true, doc: "texts of the fields: `takeoff`, `mode`"
  attr :modes, :list, required: true

  @doc """
  Arm or disarm, take off, change the mode. Each has its place, whatever the vehicle's state, and the first keeps its
  id: what it does next stands on the same button, so neither hand nor focus has to look for it.
  """
  def flight(assigns) do
    assigns =
      assign(assigns,
        in_air: View.get(assigns.view, [:mode, :in_air]),
        able: for({name, _title} <- @flight, able?(name, assigns), do: name),
        modes: for(mode <- assigns.modes, able?("set_mode", assigns, %{mode: mode}), do: mode),
        locked: locked(@flight, assigns)
      )

    assigns = assign(assigns, :next, next(assigns))

    ~H"""
    <section class="card" aria-labelledby="flight-title">
      <h2 id="flight-title">Control</h2>
      <.watching :if={@user.role == :viewer} />
      <p :if={@able == [] and @locked == [] and @user.role != :viewer} class="muted">
        The firmware of this vehicle has none of these commands here.
      </p>
      <p :for={text <- @locked} class="muted locked"><.icon name="lock" /> {text}</p>
      <div class="controls">
        <div :if={@next} class="control">
          <p class="hint control-note">{@next.note}</p>
          <.hold_button
            id="action-arm" event="command" icon={@next.icon} kind={@next.kind} shortcut="A"
            key_refusal={@next.refusal} {@next.values}
          >{@next.label}</.hold_button>
          <.hold_button
            :if={@next.other} id="action-arm-other" event="command" kind="plain"
            phx-value-type={elem(@next.other, 0)}
          >{elem(@next.other, 1)}</.hold_button>
        </div>
        <form
          :if={"takeoff" in @able} id="takeoff-form" class="control" phx-change="input"
          phx-auto-recover="ignore" phx-submit="noop"
        >
          <.field
            id="takeoff-altitude" name="altitude" label="Height (above home)" unit="m" inputmode="decimal"
            autocomplete="off" value={@inputs["altitude"]}
          />
          <.hold_button
            id="action-takeoff" event="command" icon="takeoff"
            kind={if @in_air == false, do: "primary", else: "plain"} shortcut="T"
            refusal={if @in_air, do: "It is in the air."} phx-value-type="takeoff"
          >Take off</.hold_button>
        </form>
        <form :if={"set_mode" in @able and @modes != []} id="mode-form" class="control" phx-change="input" phx-auto-recover="ignore" phx-submit="noop">
          <.field id="mode-choice" name="mode" type="select" label="Mode" options={[{"choose", ""} | Enum.map(@modes, &{&1, &1})]} value={@inputs["mode"]} />
          <.hold_button id="action-mode" event="command" kind="plain" phx-value-type="set_mode" disabled={@inputs["mode"] in [nil, ""]} reason="Choose a mode">Set mode</.hold_button>
        </form>
      </div>
    </section>
    """
  end

  # What the first button does: the step that comes next. Beside it stands what may be meant as well: an option of the
  # firmware may let it arm in this mode, and nothing may say whether it is armed.
  defp next(%{view: view, able: able}) do
    mode = View.get(view, [:mode, :mode])
    armed = View.get(view, [:mode, :armed])
    first = if "set_mode" in able, do: Firmware.arm_first(view.vehicle, mode)

    cond do
      armed == true and "disarm" in able ->
        step("Disarm", %{"phx-value-type": "disarm"}, icon: "stop", refusal: "It is armed already.")

      "arm" not in able ->
        nil

      armed == false and first != nil ->
        note = "It cannot be armed in #{mode}."
        values = %{"phx-value-type": "set_mode", "phx-value-mode": first}
        other = {"arm", "Arm all the same"}
        step("Set #{first} first", values, note: note, refusal: "#{note} Set #{first} first.", other: other)

      armed == true ->
        nil

      true ->
        step("Arm", %{"phx-value-type": "arm"},
          icon: "arm",
          kind: "primary",
          other: if(armed == nil and "disarm" in able, do: {"disarm", "Disarm"})
        )
    end
  end

  defp step(label, values, more) do
    Map.merge(
      %{label: label, values: values, icon: nil, kind: "plain", note: nil, refusal: nil, other: nil},
      Map.new(more)
    )
  end

  attr :view, View, required: true
  attr :target, :map, required: true
  attr :answer, :any, required: true
  attr :obstacles, :list, required: true

  @doc "A place that was chosen on the map, and the command for it, with the policy's answer, before anything is sent."
  def target(%{target: %{type: type}} = assigns) do
    assigns = assign(assigns, type: type, act: Guided.act(type))

    ~H"""
    <section class="card goto-panel" aria-labelledby="target-title">
      <div class="spread">
        <h2 id="target-title">{@act.title}</h2>
        <.button kind="quiet" small={true} icon="x" label="Cancel" phx-click="aim_end" />
      </div>
      <p class="mono">{View.number(@target.lat, 6)}, {View.number(@target.lon, 6)}<span :if={way = Target.way(@target, @view, " away")}>, {way}</span></p>
      <form id={"#{@type}-form"} class="control" phx-change="aim_change" phx-auto-recover="ignore" phx-submit="noop">
        <.field
          :for={name <- @act.fields} id={"#{@type}-#{name}"} name={name} label={label(@type, name)}
          unit={if name == "speed", do: "m/s", else: "m"} inputmode="decimal" autocomplete="off"
          value={@target.fields[name]}
        />
        <input :for={{name, text} <- Target.place(@target)} type="hidden" name={name} value={text} />
        <.hold_button id={"action-#{@type}"} event="command" icon={@act.icon} phx-value-type={@type} phx-value-vehicle={@view.vehicle.id} disabled={@answer != :allow} reason="It would be refused: see below">{@act.press}</.hold_button>
      </form>
      <Panel.answer answer={@answer} obstacles={@obstacles} />
    </section>
    """
  end

  defp label("set_roi", "altitude"), do: "Height of the place (above home)"
  defp label("land_here", "altitude"), do: "Height on the way (above home)"
  defp label(_type, "altitude"), do: "Height (above home)"
  defp label(_type, "altitude_msl"), do: "Altitude (MSL)"
  defp label(_type, "radius"), do: "Radius"
  defp label(_type, "speed"), do: "Speed (optional)"

  @doc "Whether the firmware has the command, with these parameters if they are given, and the user may give it."
  @spec able?(String.t(), map(), params :: map()) :: boolean()
  def able?(name, %{view: view, user: user}, params \\ %{}),
    do: Commands.lacks(view.vehicle, name, user, params) == nil

  # What a viewer lacks is a role, which the note of each command would repeat.
  defp locked(_commands, %{user: %{role: :viewer}}), do: []
  defp locked(commands, %{view: view, user: user}), do: Catalog.locked(commands, view.vehicle, user)
end
