defmodule Aerie.StandardError do
  @moduledoc "What a function writes to standard error. There is one for all tests, so only one captures it at a time."

  @doc "The function's result, and what was written to standard error while it ran."
  @spec capture((-> result)) :: {result, String.t()} when result: var
  def capture(function),
    do: :global.trans({__MODULE__, self()}, fn -> ExUnit.CaptureIO.with_io(:stderr, function) end, [node()])
end
