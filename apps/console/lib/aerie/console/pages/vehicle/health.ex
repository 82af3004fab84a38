defmodule Aerie.Console.Pages.Vehicle.Health do
  @moduledoc "What prevents a vehicle from arming; its sensors, estimator and remote control; calibrations with their prompts."
  use Aerie.Console, :component

  import Aerie.Console.Pages.Vehicle.GroupCard

  alias Aerie.Vehicle.Snapshot
  alias Aerie.Console.Commands.EntryList
  alias Aerie.Console.Pages.Vehicle.View
  alias Aerie.Console.Pages.Vehicle.Control.Actions
  alias Aerie.Console.Pages.Vehicle.Health.Calibration

  attr :view, View, required: true
  attr :user, :map, required: true
  attr :arming, :map, required: true, doc: "of `Aerie.Vehicle.Snapshot.arming/3`"
  attr :calibrations, :list, required: true, doc: "lives of calibrations"
  attr :workshop, :string, required: true, doc: "why the vehicle may not be calibrated now, nil if it may"
  attr :now, :integer, required: true

  @doc "The health section."
  def health(assigns) do
    assigns =
      assign(assigns,
        sensors: View.get(assigns.view, [:health, :unhealthy]),
        ekf: View.get(assigns.view, [:health, :ekf]),
        calibrate: Calibration.sensors(assigns)
      )

    ~H"""
    <div class="cards">
      <section id="arming" class="card" aria-labelledby="arming-title">
        <div class="spread"><h2 id="arming-title">Arming</h2><.age us={View.age(@view, :health)} limit_us={5_000_000} /></div>
        <p><.badge kind={ready_kind(@arming)}>{ready(@arming)}</.badge></p>
        <ul :if={@arming.reasons != []} class="reasons"><li :for={reason <- @arming.reasons} :key={reason}><.icon name="alert" /> {reason}</li></ul>
        <.hold_button
          :if={@arming.armed == false and Actions.able?("prearm_check", assigns)}
          id="action-prearm"
          event="command"
          kind="plain"
          hold_ms={500}
          icon="refresh"
          phx-value-type="prearm_check"
        >Check again</.hold_button>
      </section>
      <section id="sensors" class="card" aria-labelledby="sensors-title">
        <h2 id="sensors-title">Sensors</h2>
        <p :if={@sensors == nil} class="muted">Not reported by the vehicle</p>
        <p :if={@sensors == []}><.badge kind="ok">all healthy</.badge></p>
        <ul :if={@sensors not in [nil, []]} class="reasons"><li :for={name <- @sensors} :key={name}><.icon name="alert" /> {Snapshot.sensor(name)}</li></ul>
        <dl class="facts">
          <div class="fact"><dt>Vibration</dt><dd>{View.text(@view, [:health, :vibration])}</dd></div>
          <div class="fact"><dt>Clipping</dt><dd>{View.text(@view, [:health, :clipping])}</dd></div>
          <div class="fact"><dt>Load</dt><dd>{View.text(@view, [:health, :load])}</dd></div>
        </dl>
      </section>
      <section id="ekf" class="card" aria-labelledby="ekf-title">
        <h2 id="ekf-title">Estimator</h2>
        <p :if={@ekf == nil} class="muted">Not reported by the vehicle</p>
        <dl :if={@ekf} class="facts">
          <div :for={{key, name} <- ratios()} :key={name} class="fact">
            <dt>{name}</dt>
            <dd><.meter value={@ekf[key] && @ekf[key] / 1} label={name} text={View.number(@ekf[key], 2)} kind={ratio(@ekf[key])} /></dd>
          </div>
        </dl>
        <p class="hint">Below 0.5 good, 1 or more: measurement rejected.</p>
      </section>
      <section id="rc" class="card" aria-labelledby="rc-title">
        <div class="spread"><h2 id="rc-title">Remote control</h2><.age us={View.age(@view, :rc)} limit_us={5_000_000} /></div>
        <p :if={View.get(@view, [:rc, :channels]) in [nil, []]} class="muted">No channels received</p>
        <p>{signal(View.get(@view, [:rc, :rssi]) && View.text(@view, [:rc, :rssi]))}; receiver {receiver(View.get(@view, [:health, :rc_receiver]))}</p>
        <ol class="channels">
          <li :for={{pwm, n} <- channels(@view)} :key={n}><span>{n}</span> <.meter value={(pwm - 900) / 1200} label={"Channel #{n}"} text={Integer.to_string(pwm)} /></li>
        </ol>
      </section>
      <.facts id="home" title="Home" view={@view} group={:home} old_us={3_600_000_000} fields={[lat: "Latitude", lon: "Longitude", alt_msl: "Altitude (MSL)"]} />
      <section :if={@calibrate != []} id="calibration" class="card calibration" aria-labelledby="calibration-title">
        <h2 id="calibration-title">Calibration</h2>
        <p :if={@workshop == nil} class="hint">Put the vehicle down, disarmed and still. Follow its prompts below.</p>
        <p :if={@workshop} class="notice info" role="note"><.icon name="lock" /> <span>Not now: {@workshop}.</span></p>
        <EntryList.lives id="calibrations" lives={@calibrations} now={@now} user={@user} />
        <div :if={@workshop == nil} class="row">
          <.hold_button
            :for={sensor <- @calibrate} id={"calibrate-#{sensor}"} event="command" kind="plain" hold_ms={500}
            phx-value-type="calibrate" phx-value-sensor={sensor}
          >{Calibration.title(sensor)}</.hold_button>
        </div>
        <div :if={@workshop == nil and Actions.able?("calibrate_position", assigns)} class="row" role="group" aria-label="Position">
          <span class="muted">Position:</span>
          <.hold_button
            :for={position <- Calibration.positions()} id={"lies-#{position}"} event="command" kind="plain"
            hold_ms={500} phx-value-type="calibrate_position" phx-value-position={position}
          >{Calibration.title(position)}</.hold_button>
        </div>
        <div class="row">
          <.hold_button :if={@workshop == nil and Actions.able?("calibrate_accept", assigns)} id="calibrate-accept" event="command" kind="plain" hold_ms={500} icon="check" phx-value-type="calibrate_accept">Save compass calibration</.hold_button>
          <.hold_button :if={Actions.able?("calibrate_cancel", assigns)} id="calibrate-cancel" event="command" kind="plain" hold_ms={500} icon="x" phx-value-type="calibrate_cancel">Cancel calibration</.hold_button>
        </div>
      </section>
    </div>
    """
  end

  defp ready(%{armed: true}), do: "armed"
  defp ready(%{ready: true}), do: "ready to arm"
  defp ready(%{ready: false}), do: "not ready to arm"
  defp ready(%{reasons: [_ | _]}), do: "not ready to arm"
  defp ready(_unknown), do: "not reported by the vehicle"

  defp ready_kind(%{armed: true}), do: "warn"
  defp ready_kind(%{ready: true}), do: "ok"
  defp ready_kind(%{ready: false}), do: "bad"
  defp ready_kind(%{reasons: [_ | _]}), do: "bad"
  defp ready_kind(_unknown), do: "plain"

  defp ratios,
    do: [
      velocity: "Velocity",
      position_horizontal: "Position",
      position_vertical: "Height",
      compass: "Compass",
      terrain: "Terrain"
    ]

  defp ratio(nil), do: nil
  defp ratio(ratio) when ratio >= 1, do: "bad"
  defp ratio(ratio) when ratio >= 0.5, do: "warn"
  defp ratio(_ratio), do: "ok"

  defp signal(nil), do: "Signal strength not reported"
  defp signal(strength), do: "Signal strength #{strength}"

  defp receiver(true), do: "healthy"
  defp receiver(false), do: "not heard"
  defp receiver(nil), do: "state unknown"

  defp channels(view),
    do: for({pwm, n} <- Enum.with_index(View.get(view, [:rc, :channels]) || [], 1), pwm != nil, do: {pwm, n})
end
