defmodule Aerie.Console.Pages.Vehicle.Fly.Route do
  @moduledoc """
  The vehicle's mission on its own page: the route on the map, the current item, and start, pause, resume. The route is read from the vehicle
  when it flies a mission, or when somebody asks for it (`Aerie.Console.Pages.Fleet.Plans`).
  """
  use Aerie.Console, :component

  alias Aerie.Base.Names
  alias Aerie.Console.Pages.Fleet.Plans
  alias Aerie.Console.Pages.Vehicle.View
  alias Aerie.Console.Pages.Vehicle.Control.Actions

  @commands [
    {"mission_start", "Start mission", "play"},
    {"mission_pause", "Pause", "pause"},
    {"resume", "Resume", "play"}
  ]

  @doc "Whether the vehicle flies a mission now."
  @spec flying?(View.t()) :: boolean()
  def flying?(view) do
    mode = View.get(view, [:mode, :mode])
    mode in ["AUTO", "AUTO_MISSION"] and (View.get(view, [:mission, :total]) || 1) > 0
  end

  @doc "Reads the route of a vehicle that flies a mission, once; and again if its mission has changed. Messages of the reading go to the calling process."
  @spec keep(Plans.t(), Names.gateway(), View.t(), asked :: boolean()) :: Plans.t()
  def keep(plans, gateway, %View{vehicle: %{id: id}} = view, asked) do
    counts = %{id => View.get(view, [:mission, :total])}

    if not asked and flying?(view),
      do: Plans.toggle(plans, gateway, [id], counts),
      else: Plans.keep(plans, gateway, counts)
  end

  # Only what the vehicle itself shows refuses a button, and never *Pause*.
  defp refusal("mission_pause", _view), do: nil

  defp refusal(name, view) do
    cond do
      flying?(view) and View.get(view, [:mode, :in_air]) == true ->
        "It flies the mission."

      name == "resume" and View.get(view, [:mode, :in_air]) == false ->
        "It is on the ground: start the mission."

      true ->
        nil
    end
  end

  attr :view, View, required: true
  attr :user, :map, required: true
  attr :route, :map, required: true

  @doc "The card of a vehicle that has a mission."
  def mission(assigns) do
    mission = View.get(assigns.view, [:mission])

    assigns =
      assign(assigns,
        seq: mission[:seq],
        total: mission[:total],
        on?: Plans.on?(assigns.route, assigns.view.vehicle.id),
        commands: for({name, _, _} = command <- @commands, Actions.able?(name, assigns), do: command)
      )

    ~H"""
    <section :if={(@total || 0) > 0 or @on?} id="mission" class="card stack" aria-labelledby="mission-title">
      <div class="spread">
        <h2 id="mission-title">Mission</h2>
        <.button small={true} icon="plan" phx-click="route" aria-pressed={to_string(@on?)}>Route on map</.button>
      </div>
      <.meter :if={(@total || 0) > 0} value={@seq && min(@seq / @total, 1)} label="Progress of the mission" text={if @seq, do: "Item #{@seq} of #{@total}", else: "#{@total} items"} />
      <p :for={words <- Plans.summary(@route)} class="muted" role="status">{words}</p>
      <div :if={@commands != []} class="controls">
        <.hold_button
          :for={{name, label, icon} <- @commands} id={"action-#{name}"} event="command" kind="plain"
          icon={icon} refusal={refusal(name, @view)} phx-value-type={name}
        >{label}</.hold_button>
      </div>
    </section>
    """
  end
end
