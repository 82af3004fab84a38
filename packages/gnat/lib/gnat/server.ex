defmodule Gnat.Server do
  @moduledoc """
  A behaviour for modules that answer requests, run by `Gnat.ConsumerSupervisor`.

      defmodule MyApp.Echo do
        use Gnat.Server

        @impl Gnat.Server
        def request(%{body: body}), do: {:reply, body}
      end
  """

  require Logger

  @doc "Handles a message: returns `:ok`, an answer for its `reply_to`, or an error."
  @callback request(Gnat.message()) :: :ok | {:reply, iodata()} | {:error, term()}

  @doc """
  Handles an error, an invalid result or an exception of `request/1` (the second argument). The default logs it.
  """
  @callback error(Gnat.message(), term()) :: :ok | {:reply, iodata()}

  defmacro __using__(_opts) do
    quote do
      @behaviour Gnat.Server

      @impl Gnat.Server
      def error(message, error), do: Gnat.Server.log(__MODULE__, message, error)

      defoverridable error: 2
    end
  end

  @doc false
  @spec log(module(), Gnat.message(), term()) :: :ok
  def log(module, message, error) do
    text = if is_exception(error), do: Exception.message(error), else: inspect(error)
    Logger.error("#{inspect(module)} failed on a request to #{message.topic}: #{text}")
  end

  @doc false
  @spec execute(module(), Gnat.message()) :: :ok
  def execute(module, message) do
    case call(fn -> module.request(message) end) do
      :ok -> :ok
      {:reply, data} -> reply(module, message, data)
      {:error, error} -> failed(module, message, error)
      other -> failed(module, message, other)
    end
  end

  defp failed(module, message, error) do
    case call(fn -> module.error(message, error) end) do
      :ok -> :ok
      {:reply, data} -> reply(module, message, data)
      other -> log(module, message, other)
    end
  end

  defp call(fun) do
    fun.()
  rescue
    exception -> {:error, exception}
  end

  defp reply(module, %{gnat: gnat, reply_to: reply_to} = message, data) when is_binary(reply_to) do
    with {:error, error} <- Gnat.pub(gnat, reply_to, data), do: log(module, message, error)
  end

  defp reply(module, message, _data),
    do: log(module, message, "it has an answer, but the request has no reply_to")
end
