defmodule Aerie.ShortDir do
  @moduledoc "Folders for tests with sockets, whose paths have at most 107 bytes."

  @doc "A new folder with a short path that is removed with the test."
  @spec new() :: Path.t()
  def new do
    dir =
      Path.join(System.tmp_dir!(), "ae-#{System.pid()}-#{:erlang.unique_integer([:positive, :monotonic])}")

    File.mkdir_p!(dir)
    ExUnit.Callbacks.on_exit(fn -> File.rm_rf!(dir) end)
    dir
  end
end
