defmodule Aerie.Control.LedgerTest do
  use ExUnit.Case, async: true

  import Aerie.OtherVM
  import Aerie.Patience
  import ExUnit.CaptureLog

  alias Aerie.Base.Files.FolderLock
  alias Aerie.Control.Ledger
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Result

  @moduletag :tmp_dir

  defp start(dir, max_entries \\ 1000, more \\ []) do
    gateway = make_ref()
    options = [gateway: gateway, dir: dir, max_entries: max_entries, max_age_s: 3600] ++ more
    pid = start_supervised!({Ledger, options}, id: gateway)
    {gateway, pid}
  end

  defp command(id, type \\ "arm") do
    {:ok, command} = Command.new(id: id, vehicle: "VID-001", type: type)
    command
  end

  defp run(gateway, id) do
    :new = Ledger.admit(gateway, command(id))
    :ok = Ledger.sending(gateway, id, :never)
    :ok = Ledger.finish(gateway, Result.new(id, :accepted, "ACCEPTED", %{"retries" => 0}))
  end

  test "a stored result survives an orderly restart, for its owner alone", %{tmp_dir: dir} do
    {gateway, _pid} = start(dir)
    run(gateway, "a")
    assert %{entries: 1, damaged: 0, failing: nil} = Ledger.status(gateway)
    stop_supervised!(gateway)
    assert {:error, "the ledger does not run"} = Ledger.admit(gateway, command("a"))

    {gateway, _pid} = start(dir)

    assert {:stored, %Result{status: :accepted, reason: "ACCEPTED", details: %{"retries" => 0}}} =
             Ledger.admit(gateway, command("a"))

    assert {:deny, :id, _text} = Ledger.admit(gateway, command("a", "disarm"))
    assert Bitwise.band(File.stat!(Path.join(dir, "ledger")).mode, 0o777) == 0o600
  end

  test "kill -9 in the middle: results are kept, what was under way is unknown, and nothing can be sent again",
       %{
         tmp_dir: dir
       } do
    # One command after another, and each line is said when the ledger has answered: what follows a line may or may not
    # have happened.
    script = """
    Application.ensure_all_started(:control)
    alias Aerie.Vehicle.Command.Result
    {:ok, _} = Aerie.Control.Ledger.start_link(gateway: :g, dir: #{inspect(dir)}, max_entries: 100_000, max_age_s: 3600)
    for n <- Stream.iterate(1, &(&1 + 1)) do
      id = "c\#{n}"
      {:ok, command} = Aerie.Vehicle.Command.new(id: id, vehicle: "VID-001", type: "arm")
      :new = Aerie.Control.Ledger.admit(:g, command)
      :ok = Aerie.Control.Ledger.sending(:g, id, :never)
      IO.puts("sent \#{n}")
      :ok = Aerie.Control.Ledger.finish(:g, Result.new(id, :completed))
      IO.puts("done \#{n}")
      if n == 20, do: IO.puts("busy \#{System.pid()}")
    end
    """

    {port, pid} = other_vm(script, "busy ")
    kill9(pid)
    {sent, done} = said(port, {20, 20})

    {gateway, _pid} = start(dir)

    for n <- 1..done,
        do: assert({:stored, %Result{status: :completed}} = Ledger.admit(gateway, command("c#{n}")))

    for n <- (done + 1)..sent//1 do
      assert {:stored, %Result{status: status, reason: reason}} = Ledger.admit(gateway, command("c#{n}"))
      assert status == :completed or reason =~ "is not sent again"
      assert {:deny, :ledger, _text} = Ledger.sending(gateway, "c#{n}", :never)
    end

    # At most one was under way.
    assert length(Ledger.interrupted(gateway)) <= 1
  end

  defp said(port, {sent, done}) do
    receive do
      {^port, {:data, {:eol, "sent " <> n}}} -> said(port, {String.to_integer(n), done})
      {^port, {:data, {:eol, "done " <> n}}} -> said(port, {sent, String.to_integer(n)})
    after
      0 -> {sent, done}
    end
  end

  test "what was under way is given for a look at the vehicle, which may tell better", %{tmp_dir: dir} do
    {gateway, pid} = start(dir)
    :new = Ledger.admit(gateway, command("a"))
    :ok = Ledger.sending(gateway, "a", :never)
    :new = Ledger.admit(gateway, command("b"))
    ref = Process.monitor(pid)
    Process.exit(pid, :kill)
    assert_receive {:DOWN, ^ref, _, _, _}
    stop_supervised!(gateway)

    {gateway, _pid} = start(dir)
    assert [%{"id" => "a", "vehicle" => "VID-001", "type" => "arm"}] = Ledger.interrupted(gateway)
    assert :new = Ledger.admit(gateway, command("b"))
    assert {:stored, %Result{status: :unknown}} = Ledger.admit(gateway, command("a"))
    assert :ok = Ledger.finish(gateway, Result.new("a", :completed, "seen"))
    assert {:stored, %Result{status: :completed}} = Ledger.admit(gateway, command("a"))
    assert Ledger.interrupted(gateway) == []
  end

  # Whoever looks after them would take an empty list for the truth, and never look again.
  test "what was under way is not known, rather than nothing, while the folder is another gateway's", %{
    tmp_dir: dir
  } do
    {gateway, _pid} = start(dir)
    :new = Ledger.admit(gateway, command("a"))
    :ok = Ledger.sending(gateway, "a", :never)
    stop_supervised!(gateway)
    :ok = FolderLock.acquire(dir)

    log =
      capture_log(fn ->
        {gateway, _pid} = start(dir)
        assert {:error, reason} = Ledger.interrupted(gateway)
        assert reason =~ "in use by another gateway"
        :ok = Aerie.Base.Names.Book.unregister({FolderLock, Path.expand(dir)})
        eventually(fn -> match?([%{"id" => "a"}], Ledger.interrupted(gateway)) end)
      end)

    assert log =~ "in use by another gateway"
  end

  test "a torn end is cut off, damage in between is reported and kept, another format is left alone", %{
    tmp_dir: dir
  } do
    {gateway, _pid} = start(dir)
    for id <- ~w(a b c), do: run(gateway, id)
    stop_supervised!(gateway)
    path = Path.join(dir, "ledger")
    whole = File.read!(path)

    for cut <- [1, 30, byte_size(whole) - 20] do
      File.write!(path, binary_part(whole, 0, byte_size(whole) - cut))
      {gateway, _pid} = start(dir)
      assert %{damaged: 0, failing: nil} = Ledger.status(gateway)
      stop_supervised!(gateway)
    end

    File.write!(path, String.replace(whole, ~s("sent","b"), ~s("sent","x")))

    log =
      capture_log(fn ->
        {gateway, _pid} = start(dir)
        assert %{damaged: 1, entries: 3} = Ledger.status(gateway)
        assert {:stored, %Result{}} = Ledger.admit(gateway, command("b"))
        assert {:deny, :id, reason} = Ledger.admit(gateway, issued(command("d"), -1))
        assert reason =~ "may have been executed"
        stop_supervised!(gateway)
      end)

    assert log =~ path and log =~ "1 lines were damaged"
    assert File.read!(path <> ".damaged") =~ ~s("sent","x")

    File.write!(path, "aerie-ledger 2\n")

    capture_log(fn ->
      {gateway, _pid} = start(dir)
      assert {:error, reason} = Ledger.admit(gateway, command("a"))
      assert reason =~ "newer version"
      assert Ledger.problem(gateway) == reason
      stop_supervised!(gateway)
    end)

    assert File.read!(path) == "aerie-ledger 2\n"
  end

  defp issued(command, seconds),
    do: %{command | issued_at: System.os_time(:microsecond) + seconds * 1_000_000}

  test "garbage is set aside: commands go on, but none that may have been executed before", %{tmp_dir: dir} do
    path = Path.join(dir, "ledger")

    for {garbage, n} <-
          Enum.with_index(
            [:crypto.strong_rand_bytes(4_000), "something else\n", "aerie-ledger x\n", <<0>>],
            1
          ) do
      {gateway, _pid} = start(dir)
      run(gateway, "a#{n}")
      stop_supervised!(gateway)
      before = issued(command("a#{n}"), 0)
      File.write!(path, garbage)

      log =
        capture_log(fn ->
          {gateway, _pid} = start(dir)
          # The resent envelope, and what a client sends next.
          assert {:deny, :id, reason} = Ledger.admit(gateway, before)
          assert reason =~ "may have been executed"
          assert :new = Ledger.admit(gateway, issued(command("b#{n}"), 1))
          assert Ledger.problem(gateway) == nil
          stop_supervised!(gateway)
        end)

      assert log =~ "is damaged and was kept as #{path}.damaged-"
      kept = Path.wildcard(path <> ".damaged-*")
      assert length(kept) == n
      assert garbage in Enum.map(kept, &File.read!/1)

      # That holds after further restarts.
      {gateway, _pid} = start(dir)
      assert {:deny, :id, _reason} = Ledger.admit(gateway, before)
      stop_supervised!(gateway)
    end
  end

  test "a full disk: nothing new is admitted to be sent, and what was said meanwhile is written when there is room",
       %{
         tmp_dir: dir
       } do
    {gateway, pid} = start(dir)
    :new = Ledger.admit(gateway, command("a"))
    %{journal: %{file: file, path: path}} = :sys.get_state(pid, Aerie.Patience.ms())
    full = fn -> :file.open(~c"/dev/full", [:read, :write, :raw, :binary]) |> elem(1) end

    log =
      capture_log(fn ->
        :sys.replace_state(pid, fn state ->
          %{state | journal: %{state.journal | file: full.(), path: "/dev/full/no"}}
        end)

        assert {:error, "" <> _} = Ledger.sending(gateway, "a", :never)
        assert {:deny, :ledger, _text} = Ledger.sending(gateway, "a", :never)
        assert {:error, _reason} = Ledger.admit(gateway, command("b"))
        assert %{failing: "" <> _} = Ledger.status(gateway)
        :sys.replace_state(pid, fn state -> %{state | journal: %{state.journal | file: file, path: path}} end)
        assert :ok = Ledger.finish(gateway, Result.new("b", :denied, "the disk is full"))
      end)

    assert log =~ "no space left on device"
    assert log =~ "written again"
    assert %{failing: nil} = Ledger.status(gateway)
    stop_supervised!(gateway)

    {gateway, _pid} = start(dir)
    # It may have been sent: somebody was told no, and sent it all the same.
    assert {:stored, %Result{status: :unknown}} = Ledger.admit(gateway, command("a"))
    assert {:stored, %Result{status: :denied}} = Ledger.admit(gateway, command("b"))
  end

  test "a slow disk holds up only callers that must wait for it, and serves all that came meanwhile at once",
       %{
         tmp_dir: dir
       } do
    slow = :atomics.new(1, [])
    test = self()

    sync = fn _path ->
      if :atomics.get(slow, 1) == 1, do: send(test, {:sync, self()})
      if :atomics.get(slow, 1) == 1, do: receive(do: (:written -> :ok)), else: :ok
    end

    {gateway, pid} = start(dir, 1000, sync: sync)
    :atomics.put(slow, 1, 1)
    for id <- ~w(a b c d), do: assert(:new = Ledger.admit(gateway, command(id)))
    sending = fn id -> Task.async(fn -> Ledger.sending(gateway, id, :never) end) end

    a = sending.("a")
    assert_receive {:sync, first}
    others = Enum.map(~w(b c), sending)
    eventually(fn -> length(:sys.get_state(pid, Aerie.Patience.ms()).unsynced) == 2 end)
    # Nobody else waits.
    assert :ok = Ledger.sending(gateway, "d", :safe)
    assert :ok = Ledger.finish(gateway, Result.new("d", :accepted))
    assert :new = Ledger.admit(gateway, command("e"))
    assert %{syncing: {_task, [_a]}} = :sys.get_state(pid, Aerie.Patience.ms())

    send(first, :written)
    assert Task.await(a, Aerie.Patience.ms()) == :ok
    assert_receive {:sync, second}
    send(second, :written)
    assert Task.await_many(others, Aerie.Patience.ms()) == [:ok, :ok]
    refute_received {:sync, _third}
  end

  test "a disk that fails: callers that wait get the error, and the file is written again", %{tmp_dir: dir} do
    broken = :atomics.new(1, [])
    sync = fn _path -> if :atomics.get(broken, 1) == 1, do: {:error, :eio}, else: :ok end
    {gateway, _pid} = start(dir, 1000, sync: sync)
    :new = Ledger.admit(gateway, command("a"))
    :atomics.put(broken, 1, 1)

    assert capture_log(fn ->
             assert {:error, reason} = Ledger.sending(gateway, "a", :never)
             assert reason =~ "I/O error"
             # Who waits is answered before the ledger says it.
             assert %{failing: "" <> _} = Ledger.status(gateway)
           end) =~ "Commands are refused until it can be written"

    :atomics.put(broken, 1, 0)
    capture_log(fn -> assert :new = Ledger.admit(gateway, command("b")) end)
    assert %{failing: nil} = Ledger.status(gateway)
  end

  test "the file is rewritten when most of it is out of date", %{tmp_dir: dir} do
    {gateway, pid} = start(dir, 10_000)
    for n <- 1..50, do: run(gateway, "c#{n}")
    %{bytes: before} = Ledger.status(gateway)
    # As if it had grown beyond what is worth it.
    :sys.replace_state(pid, fn state ->
      filler = String.duplicate(" ", 1000)
      :ok = :file.pwrite(state.journal.file, state.journal.bytes, String.duplicate(filler, 4300))
      %{state | journal: %{state.journal | bytes: state.journal.bytes + 4_300_000}, compacted: 100}
    end)

    run(gateway, "last")
    assert %{bytes: bytes, entries: 51} = Ledger.status(gateway)
    assert bytes < before * 2
    stop_supervised!(gateway)
    {gateway, _pid} = start(dir)
    assert %{entries: 51, damaged: 0} = Ledger.status(gateway)
  end
end
