defmodule Aerie.Console.Map.OnMount do
  @moduledoc "Tells the maps of every page that other layers are offered."

  import Phoenix.LiveView

  alias Aerie.Base.PubSub

  @doc false
  def on_mount(:default, _params, _session, %{assigns: %{gateway: gateway}} = socket) do
    _subscribed = if connected?(socket), do: PubSub.subscribe(gateway, {:notice, :console_map})
    {:cont, attach_hook(socket, :console_map, :handle_info, &notice/2)}
  end

  defp notice({:fleet, {:notice, :console_map}, _nothing}, socket),
    do: {:halt, push_event(socket, "map:layers", %{})}

  defp notice(_message, socket), do: {:cont, socket}
end
