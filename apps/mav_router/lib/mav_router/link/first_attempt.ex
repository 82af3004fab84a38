defmodule MavRouter.Link.FirstAttempt do
  @moduledoc """
  Starts a link, and waits for its first attempt where only this machine can prevent it: a server whose port is taken, a
  recording that is not there. Every other link is started whether or not it can connect now; it goes on trying.
  """

  alias MavRouter.Link.Spec

  # A slow name server must not hold up who starts the link: it goes on trying. A busy machine needs seconds to find out who has a port.
  @wait_ms 15_000

  @doc """
  Calls `start` with what `MavRouter.Link.Server.start_link/1` takes as `:notify`. `{:failed, id, text}`: the link was started,
  its first attempt failed, and it is to be stopped.
  """
  @spec start(Spec.t(), (reference -> :ok | error)) :: :ok | error | {:failed, String.t(), String.t()}
        when error: {:error, term}
  def start(spec, start) do
    notify = :erlang.alias()

    try do
      with :ok <- start.(notify), do: await(spec, notify)
    after
      :erlang.unalias(notify)
    end
  end

  defp await(%Spec{server: false, recorded: false}, _notify), do: :ok

  defp await(%Spec{id: id}, notify) do
    receive do
      {^notify, :ok} -> :ok
      {^notify, {:error, text}} -> {:failed, id, text}
    after
      @wait_ms -> :ok
    end
  end
end
