defmodule Aerie.Console.Pages.Vehicle.Fly do
  @moduledoc "The section for flying: the map, a line of values and the instruments over it, control, cards below."
  use Aerie.Console, :component

  import Aerie.Console.Pages.Vehicle.GroupCard

  alias Aerie.Console.Commands.Guided
  alias Aerie.Console.Map, as: ConsoleMap
  alias Aerie.Console.Pages.Vehicle.{Events, View}
  alias Aerie.Console.Pages.Vehicle.Control.Actions
  alias Aerie.Console.Pages.Vehicle.Fly.{Line, Route}

  attr :view, View, required: true
  attr :user, :map, required: true
  attr :inputs, :map, required: true
  attr :modes, :list, required: true
  attr :target, :map, required: true, doc: "nil without one"
  attr :answer, :any, required: true
  attr :obstacles, :list, required: true
  attr :route, :map, required: true, doc: "`t:Aerie.Console.Pages.Fleet.Plans.t/0` of this vehicle"
  attr :aiming, :boolean, required: true
  attr :following, :boolean, required: true
  attr :lines, :list, required: true
  attr :events, :list, required: true
  attr :events_path, :string, required: true

  @doc "The flight section."
  def fly(assigns) do
    ~H"""
    <div class="fly">
      <div class="fly-main">
        <Line.line view={@view} events={@events} />
        <div class="fly-map">
          <ConsoleMap.map
            id="vehicle-map"
            label={"Where #{@view.vehicle.id} is"}
            follow={if @following, do: @view.vehicle.id}
            selected={[@view.vehicle.id]}
            tool={if @aiming, do: "point", else: "select"}
            menu={Guided.menu(@view.vehicle, @user)}
            class="vehicle-map"
          />
          <details id="fly-instruments" class="fly-instruments" open phx-mounted={JS.ignore_attributes("open")}>
            <summary>Instruments</summary>
            <div
              id="instruments" class="pfd" phx-hook="Instruments" phx-update="ignore"
              data-vehicle={@view.vehicle.id} data-status={@view.vehicle.status}
            ></div>
          </details>
        </div>
        <div :if={Actions.able?("goto", assigns)} class="fly-aim">
          <.button small={true} icon="goto" phx-click="aim" aria-pressed={to_string(@aiming)}>Go to…</.button>
          <span :if={@aiming} class="hint">Click the map. Nothing is sent until you confirm.</span>
        </div>
      </div>
      <div class="fly-side">
        <Actions.flight view={@view} user={@user} inputs={@inputs} modes={@modes} />
        <Actions.target :if={@target} view={@view} target={@target} answer={@answer} obstacles={@obstacles} />
        <Route.mission view={@view} user={@user} route={@route} />
      </div>
      <div class="cards fly-cards">
        <.facts id="battery" title="Battery" view={@view} group={:battery} old_us={15_000_000} fields={battery()}>
          <.meter
            value={View.get(@view, [:battery, :remaining])} label="Remaining charge"
            kind={Line.charge(View.get(@view, [:battery, :remaining])) || "ok"}
          />
          <ul :if={length(batteries(@view)) > 1} class="batteries">
            <li :for={battery <- batteries(@view)} :key={battery.id}>
              #{battery.id}: {View.number(battery.voltage, 2)} V, {View.number(battery.current, 1)} A, {percent(battery.remaining)}
            </li>
          </ul>
        </.facts>
        <.facts id="gps" title="GPS" view={@view} group={:gps} fields={gps()} />
        <.facts
          id="motion" title="Motion" view={@view} group={:velocity}
          fields={[climb: "Climb", airspeed: "Airspeed", throttle: "Throttle"]}
        />
        <section class="card" aria-labelledby="latest-title">
          <div class="spread"><h2 id="latest-title">Latest</h2><.link patch={@events_path}>All events</.link></div>
          <p :if={@lines == []} class="muted">{if @view.vehicle.via, do: "The gateway #{@view.vehicle.via} has its events.", else: "No events yet"}</p>
          <Events.lines id="latest" lines={@lines} />
        </section>
      </div>
    </div>
    """
  end

  defp battery,
    do: [
      voltage: "Voltage",
      current: "Current",
      remaining: "Remaining",
      consumed_mah: "Used",
      time_remaining: "Lasts (by the firmware)",
      charge_state: "Condition"
    ]

  defp gps,
    do: [
      fix_name: "Fix",
      satellites: "Satellites",
      hdop: "HDOP",
      vdop: "VDOP",
      h_acc: "Horizontal accuracy",
      v_acc: "Vertical accuracy",
      lat: "Latitude",
      lon: "Longitude",
      alt_msl: "Altitude (MSL)"
    ]

  defp batteries(view), do: View.get(view, [:battery, :batteries]) || []

  defp percent(nil), do: "–"
  defp percent(share), do: "#{round(share * 100)} %"
end
