defmodule Phoenix.LiveView.View.Lifecycle do
  @moduledoc "Hooks of a view: functions that run before its callbacks, in the order of their attachment."

  alias Phoenix.LiveView.Socket

  @stages [:handle_params, :handle_event, :handle_info]
  @type stage :: :handle_params | :handle_event | :handle_info

  @doc "The argument of `on_mount` as module and argument."
  @spec on_mount(module() | {module(), term()}) :: {module(), term()}
  def on_mount({module, argument}) when is_atom(module), do: {module, argument}
  def on_mount(module) when is_atom(module), do: {module, :default}

  @spec attach(Socket.t(), term(), stage(), function()) :: Socket.t()
  def attach(socket, name, stage, fun) when stage in @stages do
    hooks = hooks(socket, stage)

    if List.keymember?(hooks, name, 0),
      do: raise(ArgumentError, "there is a hook #{inspect(name)} at #{inspect(stage)} already")

    %{private: private} = socket
    stages = Map.put(private[:hooks] || %{}, stage, hooks ++ [{name, fun}])
    %{socket | private: Map.put(private, :hooks, stages)}
  end

  @doc "Runs the hooks of a mount."
  @spec mount([{module(), term()}], map(), map(), Socket.t()) :: {:cont | :halt, Socket.t()}
  def mount(hooks, params, session, socket) do
    Enum.reduce_while(hooks, {:cont, socket}, fn {module, argument}, {:cont, socket} ->
      case module.on_mount(argument, params, session, socket) do
        {:cont, %Socket{} = socket} ->
          {:cont, {:cont, socket}}

        {:halt, %Socket{redirected: nil}} ->
          raise ArgumentError, "#{inspect(module)}.on_mount halted without a redirect"

        {:halt, %Socket{} = socket} ->
          {:halt, {:halt, socket}}
      end
    end)
  end

  @doc "Runs the hooks of a stage with its arguments: `{:cont, socket}` when the view's callback follows."
  @spec run(Socket.t(), stage(), [term()]) :: {:cont | :halt, Socket.t()}
  def run(socket, stage, arguments) do
    Enum.reduce_while(hooks(socket, stage), {:cont, socket}, fn {_name, fun}, {:cont, socket} ->
      case apply(fun, arguments ++ [socket]) do
        {:cont, %Socket{} = socket} -> {:cont, {:cont, socket}}
        {:halt, %Socket{} = socket} -> {:halt, {:halt, socket}}
      end
    end)
  end

  defp hooks(socket, stage), do: get_in(socket.private, [:hooks, stage]) || []
end
