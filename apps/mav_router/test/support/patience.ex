defmodule Aerie.Patience do
  @moduledoc """
  How long a test waits for what comes at once on an idle machine. It only guards against hanging: nothing is measured by it,
  and a machine that is busy with something else makes no test fail. It stands in `config/config.exs`, for `assert_receive` as
  well.
  """

  @doc "In milliseconds."
  @spec ms() :: pos_integer()
  def ms, do: Application.fetch_env!(:ex_unit, :assert_receive_timeout)

  @doc "Until then, in the time of `System.monotonic_time(:millisecond)`."
  @spec deadline() :: integer()
  def deadline, do: System.monotonic_time(:millisecond) + ms()

  @doc "Polls until `fun` gives something truthy, for facts that send no message; gives that. `what` it is, or what says so."
  @spec eventually((-> result), String.t() | (-> String.t()), integer()) :: result when result: term()
  def eventually(fun, what \\ "it came true", deadline \\ deadline()) do
    cond do
      result = fun.() ->
        result

      System.monotonic_time(:millisecond) > deadline ->
        ExUnit.Assertions.flunk("never: #{if is_function(what), do: what.(), else: what}")

      true ->
        receive do
        after
          5 -> eventually(fun, what, deadline)
        end
    end
  end
end
