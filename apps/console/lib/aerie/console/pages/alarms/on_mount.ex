defmodule Aerie.Console.Pages.Alarms.OnMount do
  @moduledoc "Gives every page the summary of the alarms (`@alarms`), the time (`@clock`) and the strip of alarms (`@alarm_strip`); handles *Acknowledge*."

  import Phoenix.Component
  import Phoenix.LiveView

  alias Aerie.Base.PubSub
  alias Aerie.Fleet.Alarms
  alias Aerie.Console.{Clock, Part}
  alias Aerie.Console.Pages.Alarms.Strip
  alias Aerie.Console.UI.Age

  @tick_ms 1_000

  @doc false
  def on_mount(:default, _params, _session, %{assigns: %{gateway: gateway}} = socket) do
    _timer =
      if connected?(socket) do
        PubSub.subscribe(gateway, {:notice, :console_alarms})
        tick()
      end

    {:cont,
     socket
     |> assign(:alarms, Alarms.summary(gateway))
     |> clock()
     |> attach_hook(:console_alarms, :handle_info, &handle_notice/2)
     |> attach_hook(:console_acknowledge, :handle_event, &asked/3)}
  end

  # The page that lists them reads the whole list now.
  defp handle_notice({:fleet, {:notice, :console_alarms}, summary}, socket) do
    socket = socket |> assign(:alarms, summary) |> clock()
    if socket.private[:console_refresh], do: send(self(), :refresh)
    {:halt, socket}
  end

  defp handle_notice(:console_clock, socket) do
    _timer = tick()
    {:halt, clock(socket)}
  end

  defp handle_notice(_message, socket), do: {:cont, socket}

  defp tick, do: Process.send_after(self(), :console_clock, @tick_ms)

  # Texts, so that what looks the same is not sent again.
  defp clock(%{assigns: %{user: user, alarms: %{first: first} = alarms}} = socket) do
    now = System.os_time(:microsecond)
    strip = %{alarms: alarms, age: first && Age.text(now - first.since), user: user}

    socket
    |> assign(:clock, Clock.minute(now))
    |> Part.keep(:alarm_strip, &Strip.alarm_strip/1, strip)
  end

  # `Aerie.Console.SignIn.OnMount` has already refused anybody below an operator.
  defp asked("alarm-acknowledge", value, %{assigns: %{user: user, gateway: gateway}} = socket) do
    case value do
      # Those that the page showed: one that came since nobody has seen.
      %{"alarms" => ids} when is_list(ids) -> Alarms.acknowledge(gateway, ids, user.name)
      %{"alarm" => id} when is_binary(id) -> Alarms.acknowledge(gateway, [id], user.name)
      _neither -> :ok
    end

    {:halt, socket}
  end

  defp asked(_event, _value, socket), do: {:cont, socket}
end
