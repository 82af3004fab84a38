defmodule FleetWeb.Console.Alarms.OnMount do
  @moduledoc "Gives every page the summary of the alarms (`@alarms`), and handles *Seen*."

  import Phoenix.Component
  import Phoenix.LiveView

  alias Aerie.Store.PubSub
  alias FleetWeb.Console.Alarms.Server

  @doc false
  def on_mount(:default, _params, _session, %{assigns: %{gateway: gateway}} = socket) do
    if connected?(socket), do: PubSub.subscribe(gateway, {:notice, :console_alarms})

    {:cont,
     socket
     |> assign(:alarms, Server.summary(gateway))
     |> attach_hook(:console_alarms, :handle_info, &told/2)
     |> attach_hook(:console_acknowledge, :handle_event, &asked/3)}
  end

  # The page that lists them reads the whole list now.
  defp told({:fleet, {:notice, :console_alarms}, summary}, socket) do
    socket = assign(socket, :alarms, summary)
    if socket.private[:console_refresh], do: send(self(), :refresh)
    {:halt, socket}
  end

  defp told(_message, socket), do: {:cont, socket}

  # `Access.OnMount` has already refused anybody below an operator.
  defp asked("alarm-acknowledge", value, %{assigns: %{user: user, gateway: gateway}} = socket) do
    case value do
      %{"all" => _all} -> Server.acknowledge(gateway, :all, user.name)
      %{"alarm" => id} when is_binary(id) -> Server.acknowledge(gateway, [id], user.name)
      _neither -> :ok
    end

    {:halt, socket}
  end

  defp asked(_event, _value, socket), do: {:cont, socket}
end
