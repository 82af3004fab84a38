# Writes how long each test took, for the end of bin/test's output: microseconds, file and line, name. The wait for a
# place in the lane (Aerie.Lane) does not count.
defmodule Aerie.TestTimes do
  use GenServer

  @impl GenServer
  def init(_options) do
    root = System.fetch_env!("AERIE_ROOT")
    file = Path.join(System.fetch_env!("AERIE_TEST_RUN"), "#{Path.basename(File.cwd!())}.times")
    {:ok, %{root: root, file: File.open!(file, [:append, :utf8])}}
  end

  @impl GenServer
  def handle_cast({:test_finished, %{tags: tags} = test}, state) do
    waited = :persistent_term.get({Aerie.Lane, test.module, test.name}, 0)

    IO.puts(
      state.file,
      "#{test.time - waited}\t#{Path.relative_to(tags.file, state.root)}:#{tags.line}\t#{test.name}"
    )

    {:noreply, state}
  end

  def handle_cast(_event, state), do: {:noreply, state}
end
