defmodule Aerie.Console.Pages.Vehicle.Header do
  @moduledoc "The header above every section of a vehicle's page: name, reception, what it does now, problems."
  use Aerie.Console, :component

  alias Aerie.Vehicle.Firmware
  alias Aerie.Console.UI
  alias Aerie.Console.Pages.Vehicle.Fly.Doing
  alias Aerie.Console.Pages.Vehicle.View

  attr :view, View, required: true
  attr :entries, :list, required: true, doc: "the latest commands"
  attr :courses, :map, required: true, doc: "how far they are, by id"

  @doc "The header."
  def header(assigns) do
    assigns = assign(assigns, vehicle: assigns.view.vehicle, status: assigns.view.vehicle.status)

    ~H"""
    <header class="vehicle-head" data-status={@status}>
      <h1>{@vehicle.id}</h1>
      <p class="vehicle-doing">{Doing.of(@view, @entries, @courses)}</p>
      <span class="muted">{kind_of(@vehicle.vehicle_type)} · {firmware(@vehicle)}</span>
      <div class="vehicle-facts">
        <.badge :if={@vehicle.via} kind="info" class="vehicle-via">via {@vehicle.via}</.badge>
        <.badge kind={kind(@status)} class="vehicle-status">{status(@status)}</.badge>
        <.badge kind={armed_kind(View.get(@view, [:mode, :armed]))}><span class="vehicle-air">{air(View.get(@view, [:mode, :in_air]))}</span><span class="vehicle-armed">{armed(View.get(@view, [:mode, :armed]))}</span></.badge>
        <.badge class="vehicle-mode">{mode(View.get(@view, [:mode, :mode]))}</.badge>
        <.badge :for={{tone, text} <- View.warnings(@view)} kind={Atom.to_string(tone)}><.icon name="alert" />{text}</.badge>
        <span class="vehicle-elsewhere">
          <.link navigate={"/params?" <> URI.encode_query(vehicle: @vehicle.id)}>Parameters</.link>
          <.link navigate={"/plan?" <> URI.encode_query(vehicle: @vehicle.id)}>Plan</.link>
          <.link navigate={"/vehicles/" <> URI.encode(@vehicle.id, &URI.char_unreserved?/1) <> "/shadow"}>Shadow</.link>
        </span>
      </div>
    </header>
    <p :if={@status == :lost} class="notice bad" role="alert">
      <.icon name="link-off" />
      <span><strong>Vehicle lost.</strong> Not heard for {UI.Age.text(@view.silent_us)}. Last known values. Commands are refused until it is heard.</span>
    </p>
    <.stale :if={@status == :stale}>Not heard for {UI.Age.text(@view.silent_us)}.</.stale>
    """
  end

  defp firmware(%{autopilot: autopilot, firmware: firmware}),
    do: Enum.join([Firmware.title(autopilot) | List.wrap(firmware)], " ")

  defp kind_of("vtol"), do: "VTOL"
  defp kind_of(type), do: String.capitalize(type)

  defp status(status), do: Atom.to_string(status)

  defp kind(:online), do: "ok"
  defp kind(:stale), do: "warn"
  defp kind(:lost), do: "bad"

  defp air(true), do: "Flying, "
  defp air(false), do: "On the ground, "
  defp air(nil), do: ""

  defp armed(true), do: "ARMED"
  defp armed(false), do: "disarmed"
  defp armed(_unknown), do: "armed state unknown"

  # What it does in the mode, with the firmware's word if that is another one.
  defp mode(nil), do: "mode unknown"

  defp mode(mode) do
    case Firmware.meaning(mode) do
      nil -> mode
      meaning -> if String.upcase(meaning) == mode, do: mode, else: "#{meaning} · #{mode}"
    end
  end

  defp armed_kind(true), do: "warn"
  defp armed_kind(_other), do: "plain"
end
