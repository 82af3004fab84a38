defmodule MavCodec.Generated.Dialects1 do
  use MavCodec.Definition.Shard, dialects: {1, 4}
end
