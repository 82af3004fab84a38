defmodule Phoenix.LiveView.Flash do
  @moduledoc false
  # Messages that a view begins with.

  alias Phoenix.LiveView.Socket

  @spec restore(Socket.t(), map()) :: Socket.t()
  def restore(%Socket{assigns: assigns} = socket, flash), do: %{socket | assigns: %{assigns | flash: flash}}
end
