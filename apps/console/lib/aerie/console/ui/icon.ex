defmodule Aerie.Console.UI.Icon do
  @moduledoc """
  The icons: lines on a field of 24 by 24, drawn in the colour of the text. Screen readers ignore icons, so the element around
  one has a text or an `aria-label`.
  """
  use Phoenix.Component

  # Each drawn for Aerie.
  @paths %{
    "alert" => "M12 4 3 20h18zM12 10v5M12 17.5v.5",
    "altitude" => "M12 21V7M7 11l5-5 5 5M4 3h16",
    "arm" => "M12 3v9M6.5 7a8 8 0 1 0 11 0",
    "audit" => "M6 3h9l4 4v14H6zM9 11h7M9 15h7M9 7h3",
    "battery" => "M3 8h16v8H3zM21 11v2M6 11v2M9 11v2",
    "bell" => "M6 17V11a6 6 0 0 1 12 0v6l2 2H4zM10 21h4",
    "bell-off" => "M6 17V11a6 6 0 0 1 1-3M10 5.3A6 6 0 0 1 18 11v4M4 19h13M10 21h4M4 4l16 16",
    "chart" => "M4 4v16h16M7 15l4-5 3 3 5-7",
    "check" => "m5 13 5 5L20 6",
    "chevron-down" => "m6 9 6 6 6-6",
    "chevron-right" => "m9 6 6 6-6 6",
    "chevron-up" => "m6 15 6-6 6 6",
    "clock" => "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18zM12 7v5l4 2",
    "contrast" => "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18zM12 3v18M12 7h4M12 11h7M12 15h6",
    "copy" => "M9 9h11v12H9zM15 9V3H4v12h5",
    "diagnosis" => "M3 12h4l3-7 4 14 3-7h4",
    "download" => "M12 3v12M7 11l5 5 5-5M4 21h16",
    "eye" => "M2 12s4-7 10-7 10 7 10 7-4 7-10 7S2 12 2 12zM12 9a3 3 0 1 0 0 6 3 3 0 0 0 0-6z",
    "filter" => "M3 5h18l-7 8v6l-4 2v-8z",
    "goto" => "M12 21s-7-6-7-12a7 7 0 0 1 14 0c0 6-7 12-7 12zM12 7v4M10 9h4",
    "gps" => "M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8zM12 2v3M12 19v3M2 12h3M19 12h3",
    "heading" => "m12 3 6 17-6-4-6 4z",
    "help" => "M9 9a3 3 0 1 1 4 3c-1 .5-1 1-1 2.500M12 17.500v.5M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18z",
    "hold" => "M8 5v14M16 5v14",
    "home" => "M4 12 12 4l8 8M6 10v10h12V10",
    "info" => "M12 11v6M12 7.5V8M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18z",
    "inspector" =>
      "M4 6h10M4 12h6M4 18h8M17 11a3.500 3.500 0 1 0 0 7 3.500 3.500 0 0 0 0-7zM19.500 17l2.500 3",
    "keyboard" => "M2 6h20v12H2zM6 10h.5M10 10h.5M14 10h.5M18 10h.5M7 14h10",
    "land" => "M12 3v12M7 10l5 5 5-5M4 20h16",
    "layers" => "m12 3 9 5-9 5-9-5zM3 12l9 5 9-5M3 16l9 5 9-5",
    "link" => "M10 14a4 4 0 0 1 0-6l3-3a4 4 0 0 1 6 6l-2 2M14 10a4 4 0 0 1 0 6l-3 3a4 4 0 0 1-6-6l2-2",
    "link-off" =>
      "M10 5.500a4 4 0 0 1 3-1.500 4 4 0 0 1 6 5l-2 2M13.500 18.500 11 20a4 4 0 0 1-6-5l2-2M4 4l16 16",
    "list" => "M8 6h13M8 12h13M8 18h13M3 6h.5M3 12h.5M3 18h.5",
    "lock" => "M6 11h12v10H6zM8 11V8a4 4 0 0 1 8 0v3",
    "map" => "m3 6 6-3 6 3 6-3v15l-6 3-6-3-6 3zM9 3v15M15 6v15",
    "measure" => "M3 16 16 3l5 5L8 21zM7 12l2 2M10 9l2 2M13 6l2 2",
    "menu" => "M4 6h16M4 12h16M4 18h16",
    "minus" => "M5 12h14",
    "params" => "M4 6h10M18 6h2M4 12h2M10 12h10M4 18h8M16 18h4M14 4v4M6 10v4M12 16v4",
    "pause" => "M8 5v14M16 5v14",
    "plan" => "M5 19a2 2 0 1 0 0-4 2 2 0 0 0 0 4zM19 9a2 2 0 1 0 0-4 2 2 0 0 0 0 4zM7 16l10-8",
    "play" => "M7 4v16l13-8z",
    "plus" => "M12 5v14M5 12h14",
    "record" => "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18zM12 9a3 3 0 1 0 0 6 3 3 0 0 0 0-6z",
    "refresh" => "M20 11a8 8 0 1 0-2 6M20 5v6h-6",
    "restart" => "M4 11a8 8 0 1 1 2 6M4 5v6h6",
    "rtl" => "M4 12 12 5l8 7M6.500 10.500V20H12M15 17l-3 3 3 3M12 20h8v-8",
    "search" => "M11 4a7 7 0 1 0 0 14 7 7 0 0 0 0-14zM16 16l5 5",
    "settings" =>
      "M12 9a3 3 0 1 0 0 6 3 3 0 0 0 0-6zM12 2v4M12 18v4M2 12h4M18 12h4M5 5l2.800 2.800M16.200 16.200 19 19M19 5l-2.800 2.800M7.800 16.200 5 19",
    "shield" => "M12 3 4 6v6c0 5 4 8 8 9 4-1 8-4 8-9V6z",
    "sign-out" => "M10 4H4v16h6M15 8l4 4-4 4M19 12H9",
    "signal" => "M4 20v-4M9 20v-8M14 20V8M19 20V4",
    "sound" => "M4 9v6h4l5 4V5L8 9zM16 9a4 4 0 0 1 0 6M18.500 6a8 8 0 0 1 0 12",
    "sound-off" => "M4 9v6h4l5 4V5L8 9zM16 9.500l5 5M21 9.500l-5 5",
    "speed" => "M4 18a9 9 0 1 1 16 0M12 14l4-5",
    "star" =>
      "m12 3 2.800 6 6.200.800-4.500 4.400 1.100 6.300L12 17.500 6.400 20.500l1.100-6.300L3 9.800 9.200 9z",
    "stop" => "M6 6h12v12H6z",
    "system" => "M3 4h18v7H3zM3 13h18v7H3zM7 7.500h.5M7 16.500h.5",
    "tag" => "M3 3h9l9 9-9 9-9-9zM8 8h.5",
    "takeoff" => "M12 15V3M7 8l5-5 5 5M4 20h16",
    "target" => "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18zM12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8zM12 12h.01",
    "trash" => "M4 7h16M9 7V4h6v3M6 7l1 14h10l1-14M10 11v6M14 11v6",
    "upload" => "M12 16V4M7 8l5-5 5 5M4 21h16",
    "user" => "M12 4a4 4 0 1 0 0 8 4 4 0 0 0 0-8zM4 21c0-4 4-6 8-6s8 2 8 6",
    "users" =>
      "M9 5a3.500 3.500 0 1 0 0 7 3.500 3.500 0 0 0 0-7zM2 20c0-4 3.500-5 7-5s7 1 7 5M16 5.500a3.500 3.500 0 0 1 0 6M18 15c2.500.5 4 2 4 5",
    "vehicle" =>
      "M8 8l8 8M16 8l-8 8M5.500 3a2.500 2.500 0 1 0 0 5 2.500 2.500 0 0 0 0-5zM18.500 3a2.500 2.500 0 1 0 0 5 2.500 2.500 0 0 0 0-5zM5.500 16a2.500 2.500 0 1 0 0 5 2.500 2.500 0 0 0 0-5zM18.500 16a2.500 2.500 0 1 0 0 5 2.500 2.500 0 0 0 0-5z",
    "wind" => "M3 9h11a3 3 0 1 0-3-3M3 13h15a3 3 0 1 1-3 3M3 17h7a2 2 0 1 1-2 2",
    "x" => "M6 6l12 12M18 6 6 18"
  }

  @doc "The names of all icons."
  @spec names() :: [String.t()]
  def names, do: @paths |> Map.keys() |> Enum.sort()

  attr :name, :string, required: true, doc: "one of `names/0`"
  attr :class, :string, default: nil

  @doc "An icon."
  def icon(assigns) do
    assigns = assign(assigns, :path, Map.fetch!(@paths, assigns.name))

    ~H"""
    <svg class={["icon", @class]} viewBox="0 0 24 24" aria-hidden="true" focusable="false"><path d={@path} /></svg>
    """
  end

  @doc "Aerie's logo: a bird above its nest."
  def logo(assigns) do
    ~H"""
    <svg class="logo" viewBox="0 0 24 24" aria-hidden="true" focusable="false"><path
        class="logo-wing"
        d="M2 8c4-3 7-2 10 2 3-4 6-5 10-2-4 0-7 2-10 6-3-4-6-6-10-6z"
      /><path class="logo-nest" d="M4 16c2 5 14 5 16 0" /></svg>
    """
  end
end
