defmodule Aerie.Control.Policy.AuditTest do
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]
  import ExUnit.CaptureLog

  alias Aerie.Control.Policy.{Audit, Intent}
  alias Aerie.Control.Policy.Audit.Verify

  @moduletag :tmp_dir

  defp start(dir, more \\ []) do
    gateway = make_ref()
    options = [gateway: gateway, dir: dir, max_bytes: 1_048_576] ++ more
    pid = start_supervised!({Audit, options}, id: gateway)
    {gateway, pid}
  end

  # As `Audit.append/3`, without a limit that a busy machine might reach.
  defp append(gateway, entry \\ %{"type" => "decision"}),
    do: Audit.append(gateway, entry, Aerie.Patience.ms())

  test "entries survive a restart; number and hash can be kept elsewhere", %{tmp_dir: dir} do
    {gateway, _pid} = start(dir)
    assert {:ok, 2} = append(gateway, %{"type" => "decision", "id" => "a"})
    assert {:ok, %{n: 2, hash: hash, failing: nil, missed: 0}} = Audit.status(gateway)
    :ok = stop_supervised!(gateway)
    assert {:error, "the audit log does not run"} = Audit.append(gateway, %{"type" => "decision"})

    {gateway, _pid} = start(dir)
    assert {:ok, 4} = append(gateway, %{"type" => "decision", "id" => "b"})
    :ok = stop_supervised!(gateway)
    assert {:ok, %{problems: [], records: 4}} = Verify.folder(dir, {2, hash})
  end

  test "reports a flipped byte anywhere in the log at the start", %{tmp_dir: dir} do
    {gateway, _pid} = start(dir)
    for n <- 1..20, do: {:ok, _n} = append(gateway, %{"type" => "decision", "id" => "id-#{n}"})
    :ok = stop_supervised!(gateway)

    [file] = Path.wildcard(Path.join(dir, "*.jsonl"))
    File.write!(file, String.replace(File.read!(file), "id-3\"", "id-4\""))

    log =
      capture_log(fn ->
        {gateway, _pid} = start(dir)

        eventually(fn ->
          Process.list() |> Enum.all?(&(Process.info(&1, :label) != {:label, {:audit_verify, gateway}}))
        end)
      end)

    assert log =~ "#{dir} is damaged: records of the audit log are not what was written"
  end

  test "a full disk: entries are refused, what must be recorded is denied, and the log tells it afterwards",
       %{tmp_dir: dir} do
    {gateway, pid} = start(dir)
    %{log: %{store: %{segments: [%{file: file}]}}} = :sys.get_state(pid, Aerie.Patience.ms())
    # /dev/full says "no space left" to every write; a raw file belongs to the process that opened it.
    full = fn -> :file.open(~c"/dev/full", [:read, :write, :raw, :binary]) |> elem(1) end

    in_log = [
      Access.key!(:log),
      Access.key!(:store),
      Access.key!(:segments),
      Access.all(),
      Access.key!(:file)
    ]

    swap = fn open -> :sys.replace_state(pid, &put_in(&1, in_log, open.())) end

    log =
      capture_log(fn ->
        swap.(full)
        for _entry <- 1..3, do: assert({:error, "" <> _} = append(gateway))
      end)

    # Once, not for every command.
    assert [_, _] = String.split(log, "no space left on device")
    assert {:ok, %{failing: reason, missed: 3}} = Audit.status(gateway)
    assert reason =~ "no space left on device"

    goto = %Intent{type: "goto", permission: :fly}
    land = %Intent{type: "land", permission: :fly, ends_flight?: true}
    assert {:deny, :audit, text} = Audit.verdict({:error, reason}, goto, true)
    assert text =~ "goto must be recorded, and the audit log cannot be written (#{reason})"
    assert Audit.verdict({:error, reason}, goto, false) == :allow
    assert Audit.verdict({:error, reason}, land, true) == :allow
    assert Audit.verdict({:ok, 1}, goto, true) == :allow

    swap.(fn -> file end)

    capture_log(fn ->
      assert {:ok, 3} = append(gateway)
    end)

    assert {:ok, %{failing: nil, missed: 0}} = Audit.status(gateway)
    :ok = stop_supervised!(gateway)
    assert {:ok, %{problems: [], notes: [note]}} = Verify.folder(dir)
    assert note =~ "record 2: 3 records could not be written since"
  end

  test "a slow disk delays nobody; a log that is closed meanwhile is whole", %{tmp_dir: dir} do
    test = self()

    slow = fn _path ->
      send(test, {:sync, self()})
      receive(do: (:written -> :ok))
    end

    {gateway, _pid} = start(dir, sync: slow)
    assert_receive {:sync, first}
    for n <- 2..50, do: assert({:ok, ^n} = append(gateway))
    send(first, :written)
    assert_receive {:sync, _second}
    :ok = stop_supervised!(gateway)
    assert {:ok, %{problems: [], records: 50}} = Verify.folder(dir)
  end

  test "a folder that cannot be written stops no gateway, and works as soon as it can be", %{tmp_dir: dir} do
    folder = Path.join(dir, "audit")
    File.write!(folder, "a file")

    capture_log(fn ->
      {gateway, pid} = start(folder)
      assert {:error, text} = append(gateway)
      assert text =~ "cannot make folder #{folder}"
      File.rm!(folder)
      # Tried once a second at most.
      :sys.replace_state(pid, &%{&1 | tried: &1.tried - 1_000})
      assert {:ok, 3} = append(gateway)
    end)
  end

  test "two gateways do not write into one log", %{tmp_dir: dir} do
    {_gateway, _pid} = start(dir)

    capture_log(fn ->
      {second, _pid} = start(dir)
      assert {:error, text} = append(second)
      assert text =~ "in use by another gateway"
    end)
  end
end
