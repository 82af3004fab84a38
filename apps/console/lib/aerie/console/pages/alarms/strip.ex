defmodule Aerie.Console.Pages.Alarms.Strip do
  @moduledoc """
  The alarms in the header of every page: the first alarm with its vehicle and age, how many there are, and the switch for sound. It takes the same space with and
  without alarms, so that the page does not move when one appears.
  """
  use Aerie.Console, :component

  alias Aerie.Control.Policy.Roles
  alias Aerie.Fleet.Alarms
  alias Aerie.Console.Pages.Vehicle.Sections

  attr :alarms, :map, required: true
  attr :age, :string, required: true, doc: "of the first alarm, nil without one"
  attr :user, :map, required: true

  @doc "The strip."
  def alarm_strip(assigns) do
    assigns =
      assign(assigns, kind: kind(assigns.alarms), total: assigns.alarms.counts |> Map.values() |> Enum.sum())

    ~H"""
    <div
      id="alarm-strip"
      class={["alarm-strip", @kind]}
      phx-hook="AlarmSound"
      data-sound={@alarms.sound}
    >
      <.icon name={if(@alarms.first, do: "alert", else: "check")} />
      <.link :if={@alarms.first && @alarms.first.vehicle} navigate={Sections.path(@alarms.first.vehicle, "fly")} class="alarm-vehicle">{@alarms.first.vehicle}</.link>
      <.link navigate="/alarms" class="alarm-first">
        <%!-- The age beside it would be read out each second. --%>
        <span
          :if={@alarms.first} class="alarm-text" role={if @kind == "bad", do: "alert", else: "status"}
        ><span class="visually-hidden">{@alarms.first.vehicle} </span>{@alarms.first.text}</span>
        <span :if={@alarms.first} class="alarm-age">{@age}</span>
        <span :if={!@alarms.first} class="alarm-text" role="status">No alarms</span>
        <.badge :if={@total > 1} kind={@kind}>{@total}<span class="visually-hidden"> alarms</span></.badge>
        <span :if={@alarms.first && Alarms.state(@alarms.first) == :over} class="muted">Cleared</span>
      </.link>
      <button
        :if={@alarms.first && @alarms.first.by == nil && may?(@user)}
        type="button"
        class="button small"
        aria-label="Acknowledge"
        phx-click="alarm-acknowledge"
        phx-value-alarm={@alarms.first.id}
      ><.icon name="check" class="phone-only" /><span class="wide-only">Acknowledge</span></button>
      <button
        type="button"
        id="alarm-sound"
        class="button quiet icon-only"
        data-action="sound"
        aria-label="Sound of alarms"
        aria-pressed="false"
        phx-mounted={JS.ignore_attributes("aria-pressed")}
      ><.icon name="sound" class="when-on" /><.icon name="sound-off" class="when-off" /></button>
    </div>
    """
  end

  @doc "Whether a user may acknowledge alarms."
  @spec may?(Roles.source()) :: boolean()
  def may?(user), do: Roles.at_least?(user.role, :operator)

  defp kind(%{first: nil}), do: "off"
  defp kind(%{first: alarm}), do: kind_of(alarm)

  @doc "The kind of badge of an alarm."
  @spec kind_of(Alarms.alarm()) :: String.t()
  def kind_of(alarm) do
    case {Alarms.state(alarm), alarm.severity} do
      {:over, _severity} -> "off"
      {_state, :critical} -> "bad"
      {_state, :warning} -> "warn"
      {_state, :notice} -> "info"
    end
  end
end
